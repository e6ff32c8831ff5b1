"""The thesis's own listings as programs that run: sections 4.7.1 to 4.7.4 and the examples of B.1.2 and B.2."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from eal_actors import Fleet, connect
from eal_actors.classic import (
    ACTUATOR,
    BOOL,
    CHAR,
    COMMUNICATION,
    DOUBLE,
    EAL,
    FLOAT,
    INT,
    ISPTR,
    ISSHORT,
    ISUNSIGNED,
    OTHER,
    SENSOR,
    VOID,
    EALBaseResource,
    EALconnect,
    EALDataInfo_t,
    EALdisconnect,
    EALPlugin,
    EALResource,
    EALResourceInfo_t,
)
from eal_actors.kernel.errors import PluginError, ResourceFaultError
from eal_actors.testing.conformance.bench import Bench, settings_of
from eal_actors.testing.conformance.runner import run_checks
from tests.plugin_files import write_plugin

SAMPLE = '''
from eal_actors.classic import ACTUATOR, INT, SENSOR, EALBaseResource, EALDataInfo_t, EALPlugin


class SampleResource(EALBaseResource):
    """The sample resource of sections 4.7.1 and 4.7.2."""

    def __init__(self):
        self.info_.type = SENSOR | ACTUATOR
        self.sampleValue = 0

    def getValue(self):
        return EALDataInfo_t(INT, self.sampleValue)

    def setValue(self, value):
        if value and value.type == INT:
            self.sampleValue = value.data
            return 1
        return -1

    def halt(self):
        pass


def createSampleResource():
    return SampleResource()


def destroySampleResource(resource):
    del resource


def connect():
    return EALPlugin("SampleResource", None)


def disconnect(plugin):
    del plugin
'''

EVERY_METHOD = '''
from eal_actors.classic import *


class Everything(EALBaseResource):
    """Every method of table 4.2, in the thesis's form."""

    def __init__(self):
        self.info_.type = COMMUNICATION | OTHER
        self.bytes = b""
        self.config = EALDataInfo_t(INT, 9600)

    def getStatus(self):
        return len(self.bytes)

    def sendReq(self, req):
        return EALDataInfo_t(CHAR, req[::-1], isPtr=ISPTR) if req else None

    def sendCmd(self, cmd, data):
        return -1 if data is None else len(cmd) + data.data

    def readComm(self, data, length):
        if self.bytes.startswith(b"!"):
            return -1
        data.data, self.bytes = self.bytes[:length], self.bytes[length:]
        return len(data.data)

    def writeComm(self, data, length):
        self.bytes += bytes(data.__eal_data__().payload)[:length]
        return length

    def getConfig(self, config):
        return self.config if config == "baud" else None

    def setConfig(self, config, data):
        self.config = data
        return 1 if config == "baud" else -1

    def ownMethod(self):
        return "reached"
'''


@pytest.fixture
def classic_fleet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A fleet file with one robot, whose plugins are in the thesis's form."""
    write_plugin(tmp_path, "thesis_sample", SAMPLE, "SampleResource")
    write_plugin(tmp_path, "everything", EVERY_METHOD, "Everything")
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(
        "version: 1\nname: f\nplugin_dirs: [plugins]\nrobots:\n  one: {plugins: {thesis_sample: {}, everything: {}}}\n"
    )
    monkeypatch.setenv("EAL_FLEET", str(fleet))
    return fleet


@pytest.fixture
def eal(classic_fleet: Path) -> Iterator[EAL]:
    """A connection to the robot."""
    client = EALconnect()
    assert client is not None
    yield client
    EALdisconnect(client)


# Sections 4.7.1 to 4.7.4.


def test_the_sample_user_code_on_the_sample_plugin(classic_fleet: Path) -> None:
    program = Path(__file__).parents[2] / "scenarios" / "classic" / "sample_user_code.py"
    ran = subprocess.run([sys.executable, program], capture_output=True, text=True, timeout=100, check=False)
    assert ran.stdout.splitlines() == [
        "Available resource: SampleResource",
        "Available resource: Everything",
        "SampleResource value = 0",
        "SampleResource value is now = 42",
    ]
    assert ran.returncode == 0, ran.stderr


def test_the_sample_refuses_what_is_no_int(eal: EAL) -> None:
    sample = eal.findResource("SampleResource")
    assert eal.setValue(sample, EALDataInfo_t(CHAR, "s")) == -1
    assert eal.setValue(sample, None) == -1
    value = eal.getValue(sample)
    assert value == EALDataInfo_t(INT, 0, 4)


def test_the_sample_plugin_conforms(classic_fleet: Path) -> None:
    folder = classic_fleet.parent / "plugins" / "thesis_sample"
    results = list(run_checks(Bench(folder, settings_of({}))))
    assert {result.check.name: result.problems for result in results if result.outcome == "failed"} == {}
    assert sum(result.outcome == "ok" for result in results) > 8


def test_both_forms_of_the_plugin_constructor() -> None:
    assert EALPlugin("SampleResource", None).list_resources() == ("SampleResource",)
    assert EALPlugin("A", "B", None, "ignored").list_resources() == ("A", "B")
    assert EALPlugin(1, "SampleResource", "ignored").list_resources() == ("SampleResource",)
    with pytest.raises(PluginError, match="names no resource"):
        EALPlugin(None)
    with pytest.raises(PluginError, match="promised 2 resources, but only 1"):
        EALPlugin(2, "A", None)


def test_bare_resources_return_null_and_invalid() -> None:
    bare = EALBaseResource()
    assert bare.getValue() is bare.sendReq("x") is bare.getConfig("x") is None
    assert {bare.getStatus(), bare.setValue(None), bare.sendCmd("x", None), bare.readComm(None, 1)} == {-1}
    assert {bare.writeComm(None, 1), bare.setConfig("x", None)} == {-1}
    assert isinstance(bare, EALResource)
    assert bare.info_ == EALResourceInfo_t("", OTHER)
    assert bare.info().methods == frozenset()


def test_programs_without_a_fleet_file_reach_the_sample_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("EAL_FLEET", raising=False)
    monkeypatch.chdir(tmp_path)
    client = EALconnect()
    assert client is not None
    assert client.getResourceList() == ["SampleResource"]
    EALdisconnect(client)
    EALdisconnect(None)


# Section B.1.2.


@pytest.mark.parametrize(
    ("data", "payload"),
    [
        (EALDataInfo_t(INT), b"\0\0\0\0"),
        (EALDataInfo_t(CHAR), b"\0"),
        (EALDataInfo_t(FLOAT), b"\0\0\0\0"),
        (EALDataInfo_t(DOUBLE), b"\0" * 8),
        (EALDataInfo_t(BOOL), b"\0"),
        (EALDataInfo_t(BOOL, True), b"\1"),
        (EALDataInfo_t(VOID), b""),
        (EALDataInfo_t(VOID, None), b""),
        (EALDataInfo_t(VOID, b"ab", isPtr=ISPTR), b"ab"),
        (EALDataInfo_t(INT, length=8, isPtr=ISPTR), b"\0" * 8),
        (EALDataInfo_t(INT, b"\1\0\0\0", isPtr=ISPTR), b"\1\0\0\0"),
        (EALDataInfo_t(CHAR, b"\xff\0", isPtr=ISPTR), b"\xff\0"),
        (EALDataInfo_t(INT, 7, isShort=ISSHORT), b"\7\0"),
    ],
)
def test_every_type_can_be_sent(data: EALDataInfo_t, payload: bytes, eal: EAL) -> None:
    everything = eal.findResource("Everything")
    assert eal.writeComm(everything, data, len(payload)) == len(payload)
    buffer = EALDataInfo_t(VOID, None, 64, ISPTR)
    assert eal.readComm(everything, buffer, 64) == len(payload)
    assert buffer.data == payload.ljust(64, b"\0")


# Section B.2, call by call.


def test_resource_knowledge(eal: EAL) -> None:
    assert eal.getResourceList() == ["SampleResource", "Everything"]
    everything = eal.findResource("Everything")
    for info in (eal.resourceInfo(everything), eal.resourceInfoByName("Everything")):
        assert info is not None
        assert (info.name, info.type) == ("Everything", COMMUNICATION | OTHER)
        assert info.description == "Every method of table 4.2, in the thesis's form."
        assert info.methods == frozenset(
            {"get_status", "send_req", "send_cmd", "read_comm", "write_comm", "get_config", "set_config"}
        )
    sample = eal.resourceInfoByName("SampleResource")
    assert sample is not None
    assert sample.type == SENSOR | ACTUATOR
    assert eal.getStatus(everything) == 0


def test_every_method_of_a_resource_in_the_thesis_form(eal: EAL) -> None:
    everything = eal.findResource("Everything")
    assert eal.sendReq(everything, "abc") == EALDataInfo_t(CHAR, "cba", 3, isPtr=True)
    assert eal.sendReq(everything, "") is None  # the resource returned NULL
    assert eal.sendCmd(everything, "go", EALDataInfo_t(INT, 5)) == 7
    assert eal.sendCmd(everything, "go", None) == -1
    assert eal.getConfig(everything, "baud") == EALDataInfo_t(INT, 9600, 4)
    assert eal.setConfig(everything, "baud", EALDataInfo_t(INT, 300)) == 1
    assert eal.getConfig(everything, "baud") == EALDataInfo_t(INT, 300, 4)
    assert eal.getConfig(everything, "nonsense") is None
    assert eal.getValue(everything) is None  # not overridden
    assert eal.setValue(everything, EALDataInfo_t()) == -1


def test_null_for_data_is_a_failure(eal: EAL) -> None:
    everything = eal.findResource("Everything")
    assert eal.setValue(everything, None) == -1
    assert eal.writeComm(everything, None, 3) == -1
    assert eal.readComm(everything, None, 3) == -1


@pytest.mark.parametrize(
    ("written", "buffer", "length", "read"),
    [
        (b"hello", EALDataInfo_t(CHAR, "", 10, ISPTR), 10, "hello"),
        (b"hello", EALDataInfo_t(CHAR, "old", isPtr=ISPTR), 3, "hel"),
        (b"\xff\xfe", EALDataInfo_t(CHAR, "", 10, ISPTR), 10, b"\xff\xfe"),
        (b"a\0b", EALDataInfo_t(CHAR, "", 10, ISPTR), 10, b"a\0b"),
        (b"ab", EALDataInfo_t(CHAR, [], 3, ISPTR, ISUNSIGNED), 3, [97, 98, 0]),
        (b"\1\0\0\0\2\0\0\0", EALDataInfo_t(INT, [9] * 3, 12, ISPTR), 12, [1, 2, 0]),
        (b"\1\0\0\0\2", EALDataInfo_t(INT, isPtr=ISPTR), 8, [1, 2]),
        (b"\1\2", EALDataInfo_t(), 4, 0x201),
        (b"ab", EALDataInfo_t(VOID, isPtr=ISPTR), 9, b"ab"),
    ],
)
def test_reading_keeps_the_type_of_the_caller(
    eal: EAL, written: bytes, buffer: EALDataInfo_t, length: int, read: object
) -> None:
    everything, before = eal.findResource("Everything"), (buffer.type, buffer.length, buffer.isPtr, buffer.isUnsigned)
    eal.writeComm(everything, EALDataInfo_t(VOID, written, isPtr=ISPTR), len(written))
    assert eal.readComm(everything, buffer, length) == min(length, len(written))
    assert buffer.data == read
    assert (buffer.type, buffer.length, buffer.isPtr, buffer.isUnsigned) == before
    assert eal.writeComm(everything, buffer, min(length, len(written))) > 0  # what was read can be sent again


def test_reading_more_than_the_buffer_holds_is_refused_before_it_takes_a_byte(eal: EAL) -> None:
    everything = eal.findResource("Everything")
    eal.writeComm(everything, EALDataInfo_t(VOID, b"abcdef", isPtr=ISPTR), 6)
    assert eal.readComm(everything, EALDataInfo_t(CHAR, "", 3, ISPTR), 6) == -1
    assert eal.readComm(everything, EALDataInfo_t(), 6) == -1
    assert eal.getStatus(everything) == 6


def test_a_read_that_the_resource_fails_is_a_failure(eal: EAL) -> None:
    everything = eal.findResource("Everything")
    eal.writeComm(everything, EALDataInfo_t(CHAR, "!", isPtr=ISPTR), 1)
    assert eal.readComm(everything, EALDataInfo_t(VOID, isPtr=ISPTR), 1) == -1


def test_direct_access(eal: EAL) -> None:
    resource = eal.getResource("Everything")
    assert isinstance(resource, EALResource)
    assert resource.getStatus() == 0
    assert resource.writeComm(EALDataInfo_t(CHAR, "abc", isPtr=ISPTR), 3) == 3
    assert resource.getStatus() == 3
    assert resource.ownMethod() == "reached"  # type: ignore[attr-defined]  # the resource's own
    resource.bytes = b"four"  # type: ignore[attr-defined]
    assert resource.getStatus() == 4
    again = eal.getResource("Everything")
    assert eal.returnResource(resource) == 1
    assert eal.returnResource(again) == 1
    assert eal.returnResource(again) == -1
    assert eal.returnResource(None) == -1
    assert eal.getResource("Nothing") is None


def test_direct_access_to_resources_of_any_plugin_has_the_methods_of_the_thesis(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("EAL_FLEET", raising=False)
    client = EALconnect()
    assert client is not None
    resource = client.getResource("SampleResource")
    assert resource is not None
    assert resource.setValue(EALDataInfo_t(INT, 7)) == 1
    assert resource.getValue() == EALDataInfo_t(INT, 7, 4)
    assert client.returnResource(resource) == 1
    EALdisconnect(client)


def test_other_users_meet_the_same_resources(classic_fleet: Path) -> None:
    with connect(fleet=classic_fleet) as eal:
        everything = eal.find_resource("Everything")
        assert eal.send_req(everything, "abc").value == "cba"
        with pytest.raises(ResourceFaultError, match="sendReq returned NULL"):
            eal.send_req(everything, "")
        assert eal.set_config(everything, "baud", EALDataInfo_t(INT, 300)) == 1  # the thesis's data, given to it
        assert eal.get_config(everything, "baud").value == 300


WRONG: list[Callable[[EAL, int], object]] = [
    lambda eal, one: eal.sendCmd(one, None, None),  # type: ignore[arg-type]
    lambda eal, one: eal.setValue(one, "text"),  # type: ignore[arg-type]
    lambda eal, one: eal.writeComm(one, EALDataInfo_t(INT, 2**40), 8),
    lambda eal, one: eal.writeComm(one, EALDataInfo_t(INT, isShort=True, isLong=True), 8),
    lambda eal, one: eal.readComm(one, EALDataInfo_t(VOID), 1),
    lambda eal, one: eal.readComm(one, EALDataInfo_t(DOUBLE, isLong=True), 1),
    lambda eal, one: eal.returnResource(eal),  # type: ignore[arg-type]
]


@pytest.mark.parametrize("wrong", WRONG)
def test_wrong_arguments_are_failures_and_the_robot_serves_on(eal: EAL, wrong: Callable[[EAL, int], object]) -> None:
    everything = eal.findResource("Everything")
    assert wrong(eal, everything) == -1
    assert eal.getStatus(everything) == 0


def test_modern_programs_may_use_a_fleet_of_classic_robots(classic_fleet: Path) -> None:
    with Fleet.load(classic_fleet) as fleet:
        assert fleet["one"]["SampleResource"].set_value(3).get() == 1
        assert fleet["one"]["SampleResource"].get_value().get().value == 3
