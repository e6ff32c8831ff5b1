"""The seventeen calls, in our names and in the thesis's."""

from __future__ import annotations

import inspect
import textwrap
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

import eal_actors
from eal_actors import EAL, EALData, Fleet, classic, connect
from eal_actors.device.resource import Resource
from eal_actors.kernel.errors import (
    ArgumentError,
    ConfigError,
    PreemptedError,
    ResourceInUseError,
    ResourceNotFoundError,
    RobotNotFoundError,
    UnavailableError,
    UnsupportedError,
)
from tests.plugin_files import write_plugin

SEVENTEEN = [
    # thesis name, our name, section
    ("EALconnect", "connect", "B.2.1.1"),
    ("EALdisconnect", "disconnect", "B.2.1.2"),
    ("getResourceList", "get_resource_list", "B.2.2.1"),
    ("findResource", "find_resource", "B.2.2.2"),
    ("resourceInfo", "resource_info", "B.2.2.3"),
    ("resourceInfoByName", "resource_info_by_name", "B.2.2.4"),
    ("getStatus", "get_status", "B.2.2.5"),
    ("getValue", "get_value", "B.2.3.1"),
    ("setValue", "set_value", "B.2.3.2"),
    ("sendReq", "send_req", "B.2.3.3"),
    ("sendCmd", "send_cmd", "B.2.3.4"),
    ("readComm", "read_comm", "B.2.3.5"),
    ("writeComm", "write_comm", "B.2.3.6"),
    ("getConfig", "get_config", "B.2.3.7"),
    ("setConfig", "set_config", "B.2.3.8"),
    ("getResource", "get_resource", "B.2.4.1"),
    ("returnResource", "return_resource", "B.2.4.2"),
]


def test_there_are_seventeen_calls() -> None:
    assert len(SEVENTEEN) == 17


@pytest.mark.parametrize(("thesis", "ours", "section"), SEVENTEEN)
def test_each_call_exists_under_both_names_and_names_its_section(thesis: str, ours: str, section: str) -> None:
    old = getattr(classic, thesis, None) or getattr(classic.EAL, thesis)
    new = getattr(eal_actors, ours, None) or getattr(EAL, ours)
    for call in (old, new):
        assert f"thesis {section}" in (inspect.getdoc(call) or "")


def test_no_object_has_both_naming_styles() -> None:
    ours = {name for name in dir(EAL) if not name.startswith("_")}
    thesis = {name for name in dir(classic.EAL) if not name.startswith("_")}
    assert ours & thesis <= {"tasks"}  # one word has no style


PLUGIN = '''
from eal_actors.plugin import *

class Line(Resource):
    """A line that gives back what was written."""
    types = ResourceType.COMMUNICATION
    def __init__(self):
        self.bytes = b""
    def get_status(self):
        return len(self.bytes)
    def read_comm(self, length):
        taken, self.bytes = self.bytes[:length], self.bytes[length:]
        return taken
    def write_comm(self, data, length):
        self.bytes += bytes(data.payload)[:length]
        return length
    @request("length", ValueInfo(DataType.INT))
    def length(self):
        return len(self.bytes)
    @request("echo<number>", ValueInfo(DataType.INT), ValueInfo(DataType.INT))
    def echo(self, number):
        return number
    @command("clear")
    def clear(self):
        self.bytes = b""
    @command("fill", ValueInfo(DataType.INT, minimum=0, maximum=9))
    def fill(self, count):
        self.bytes = b"x" * count
    @config("baud", ValueInfo(DataType.INT, minimum=300, maximum=115200))
    def baud(self):
        return getattr(self, "_baud", 9600)
    @config_setter("baud")
    def set_baud(self, baud):
        self._baud = baud
    def halt(self):
        if hasattr(self, "halting"):
            self.halting.set()
            self.may_halt.wait()
'''


@pytest.fixture
def line_fleet(tmp_path: Path) -> Path:
    write_plugin(tmp_path, "line", PLUGIN, "Line")
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(
        textwrap.dedent("""\
        version: 1
        plugin_dirs: [plugins]
        robots:
          one: {plugins: {line: {}}}
          two: {plugins: {line: {}, sample: {}}}
        """)
    )
    return fleet


@pytest.fixture
def eal(line_fleet: Path) -> Iterator[EAL]:
    with connect("one", fleet=line_fleet) as eal:
        yield eal


def test_the_structured_calls(eal: EAL) -> None:
    line = eal.find_resource("Line")
    assert eal.get_resource_list() == ["Line"]
    assert eal.write_comm(line, b"hello", 4) == 4
    assert eal.get_status(line) == 4
    assert eal.send_req(line, "length").value == 4
    assert eal.read_comm(line, 3).value == b"hel"
    assert eal.send_cmd(line, "clear") == 1
    assert eal.send_cmd(line, "fill", 5) == 1
    assert eal.get_status(line) == 5
    assert eal.get_config(line, "baud").value == 9600
    assert eal.set_config(line, "baud", 300) == 1
    assert eal.get_config(line, "baud").value == 300
    assert eal.resource_info(line) == eal.resource_info_by_name("Line")
    assert eal.resource_info(line).types.names == ("COMMUNICATION",)


def test_errors_are_typed_and_name_the_resource(eal: EAL) -> None:
    line = eal.find_resource("Line")
    with pytest.raises(UnsupportedError, match="one/Line: Line does not support get_value"):
        eal.get_value(line)
    with pytest.raises(ArgumentError, match=r"one/Line: command 'fill': its argument must be int 0\.\.9, not 10"):
        eal.send_cmd(line, "fill", 10)
    with pytest.raises(ArgumentError, match="unknown command 'cler'; did you mean 'clear'"):
        eal.send_cmd(line, "cler")
    with pytest.raises(ResourceNotFoundError):
        eal.find_resource("Lime")
    with pytest.raises(ResourceNotFoundError, match="no resource has the id 99"):
        eal.get_value(99)


def test_the_connection_stays_open_until_all_resources_are_returned(line_fleet: Path) -> None:
    eal = connect("one", fleet=line_fleet)
    first, second = eal.get_resource("Line"), eal.get_resource("Line")
    assert isinstance(first, Resource)
    assert first is second
    with pytest.raises(ResourceInUseError, match=r"Line \(2 times\)"):
        eal.disconnect()
    assert eal.return_resource(first) == 1
    assert eal.return_resource(second) == 1
    with pytest.raises(ResourceInUseError):
        eal.return_resource(first)
    with eal.borrowed("Line") as resource:
        assert resource.get_status() == 0
    eal.disconnect()


def test_leaving_the_with_block_disconnects_even_if_a_resource_is_checked_out(line_fleet: Path) -> None:
    with pytest.raises(ResourceInUseError), connect("one", fleet=line_fleet) as eal:
        eal.get_resource("Line")


def test_connections_to_one_file_share_its_fleet(line_fleet: Path) -> None:
    with connect("one", fleet=line_fleet) as first, connect("one", fleet=line_fleet) as second:
        first.write_comm(first.find_resource("Line"), b"note")
        assert second.read_comm(second.find_resource("Line"), 9).value == b"note"


def test_the_host_is_a_robot_of_the_fleet(line_fleet: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EAL_FLEET", str(line_fleet))
    with connect("two", 50000) as eal:
        assert eal.get_resource_list() == ["Line", "SampleResource"]
    with pytest.raises(RobotNotFoundError, match=r"has no robot 'three'.*it has one, two"):
        connect("three")
    with pytest.raises(RobotNotFoundError, match="has 2 robots; name one"):
        connect()


def test_an_open_fleet_can_be_used_and_stays_open(line_fleet: Path) -> None:
    with Fleet.load(line_fleet) as fleet:
        with connect("one", fleet=fleet) as eal:
            assert eal.get_status(eal.find_resource("Line")) == 0
        assert fleet["one"]["Line"].get_status().get() == 0


def test_a_closed_connection_refuses_calls(line_fleet: Path) -> None:
    with connect("one", fleet=line_fleet), connect("one", fleet=line_fleet) as eal:
        line = eal.find_resource("Line")
        eal.disconnect()
        with pytest.raises(UnavailableError, match="one: this connection is closed; connect again"):
            eal.get_status(line)


def test_the_last_connection_to_a_robot_halts_it() -> None:
    sim = Path(__file__).parents[2] / "fleets" / "sim.yaml"
    with connect("evbot2-1", fleet=sim), connect("roomba-1", fleet=sim) as first:
        base = first.find_resource("Base")
        with connect("roomba-1", fleet=sim):
            pass
        robot = first._robot
        drive = robot["Base"].send_cmd("r3600", timeout_s=1000.0)
        robot["Base"].get_config("step_m").get()  # by now it has begun
        with connect("roomba-1", fleet=sim):
            pass
        assert first.get_status(base) == 1
        first.disconnect()
        with pytest.raises(PreemptedError, match="halted"):
            drive.get()


def test_a_second_thread_that_disconnects_returns_when_the_robot_has_halted(line_fleet: Path) -> None:
    with connect("two", fleet=line_fleet), connect("one", fleet=line_fleet) as eal:
        with eal.borrowed("Line") as line:
            line.halting, line.may_halt = threading.Event(), threading.Event()  # type: ignore[attr-defined]
        threads = [threading.Thread(target=eal.disconnect) for _ in range(2)]
        threads[0].start()
        line.halting.wait()  # type: ignore[attr-defined]
        threads[1].start()
        threads[1].join(0.2)
        has_returned = not threads[1].is_alive()
        line.may_halt.set()  # type: ignore[attr-defined]
        for thread in threads:
            thread.join()
        assert not has_returned


def test_a_fleet_that_is_not_connected_refuses_calls(line_fleet: Path) -> None:
    fleet = Fleet.load(line_fleet)
    with pytest.raises(UnavailableError, match="is not connected"):
        connect("one", fleet=fleet)
    with pytest.raises(RobotNotFoundError, match="robot 'one' of fleet 'fleet' is not connected"):
        fleet["one"]
    with pytest.raises(RobotNotFoundError, match="unknown robot 'onee'; did you mean 'one'"):
        fleet["onee"]


def test_what_opens_neither_a_robot_nor_a_fleet_is_named(line_fleet: Path) -> None:
    with pytest.raises(TypeError, match=r"the name of one robot, not \['arm'\]"):
        connect(["arm"], fleet=line_fleet)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"Fleet\.load reads a file, not Fleet\('sim'\)"):
        Fleet("sim")  # type: ignore[arg-type]


def test_robots_can_be_connected_one_after_the_other(line_fleet: Path) -> None:
    with Fleet.load(line_fleet).connect(["two"]) as fleet:
        assert list(fleet) == ["two"]
        two = fleet["two"]
        fleet.connect()
        assert sorted(fleet) == ["one", "two"]
        assert fleet["two"] is two
        assert [robot.name for robot in fleet.select(["one"])] == ["one"]
        assert len(fleet.halt().get()) == 2
        assert fleet.problems == []


def test_two_threads_may_connect_one_fleet(line_fleet: Path) -> None:
    fleet = Fleet.load(line_fleet)
    threads = [threading.Thread(target=fleet.connect) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    names = [thread.name for thread in threading.enumerate()]
    assert names.count("one") == names.count("two") == 1
    fleet.close()


def test_a_missing_fleet_file_is_named() -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.yaml"):
        connect(fleet="nowhere.yaml")


def test_many_threads_may_share_one_connection(eal: EAL) -> None:
    line = eal.find_resource("Line")
    echoes: dict[int, list[int]] = {number: [] for number in range(4)}

    def work(number: int) -> None:
        for _ in range(50):
            eal.send_cmd(line, "fill", number)
            echoes[number].append(int(eal.send_req(line, f"echo{number}").value))

    threads = [threading.Thread(target=work, args=(number,)) for number in echoes]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert echoes == {number: [number] * 50 for number in range(4)}


class TestClassic:
    """The thesis's return conventions."""

    @pytest.fixture
    def old(self, line_fleet: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[classic.EAL]:
        monkeypatch.setenv("EAL_FLEET", str(line_fleet))
        eal = classic.EALconnect("two", 50000)
        assert eal is not None
        yield eal
        classic.EALdisconnect(eal)

    def test_no_connection_is_none(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("EAL_FLEET", "nowhere.yaml")
        assert classic.EALconnect() is None

    def test_the_sample_resource(self, old: classic.EAL) -> None:
        sample = old.findResource("SampleResource")
        value = old.getValue(sample)
        assert value == classic.EALDataInfo_t(classic.INT, 0, 4)
        value.data = 42
        assert old.setValue(sample, value) == 1
        again = old.getValue(sample)
        assert again is not None
        assert again.data == 42

    def test_failures_are_minus_one_and_none(self, old: classic.EAL) -> None:
        line = old.findResource("Line")
        text = classic.EALDataInfo_t(classic.CHAR, "abc", isPtr=classic.ISPTR)
        assert old.findResource("Nothing") == -1
        assert old.getValue(99) is None
        assert old.resourceInfo(99) is None
        assert old.resourceInfoByName("Nothing") is None
        assert old.getStatus(99) == -1
        assert old.setValue(line, text) == -1
        assert old.sendCmd(line, "nonsense", None) == -1
        assert old.sendReq(line, "nonsense") is None
        assert old.getConfig(line, "nonsense") is None
        assert old.setConfig(line, "baud", text) == -1
        assert old.readComm(99, text, 3) == -1
        assert old.writeComm(99, text, 3) == -1
        assert old.getResource("Nothing") is None

    def test_reading_fills_the_data_given(self, old: classic.EAL) -> None:
        line = old.findResource("Line")
        sent = classic.EALDataInfo_t(classic.CHAR, "hello", isPtr=classic.ISPTR)
        assert old.writeComm(line, sent, 5) == 5
        received = classic.EALDataInfo_t(classic.CHAR, "", 10, classic.ISPTR)
        assert old.readComm(line, received, 3) == 3
        assert received.data == "hel"
        request = old.sendReq(line, "length")
        assert request is not None
        assert request.data == 2
        assert old.sendCmd(line, "fill", classic.EALDataInfo_t(classic.INT, 4)) == 1
        assert old.getStatus(line) == 4

    def test_a_resource_that_is_out_keeps_the_connection(self, old: classic.EAL) -> None:
        resource = old.getResource("Line")
        assert resource is not None
        classic.EALdisconnect(old)
        assert old.getStatus(old.findResource("Line")) == 0
        assert old.returnResource(resource) == 1
        assert old.returnResource(resource) == -1

    def test_what_cannot_be_packed_is_a_failure(self, old: classic.EAL) -> None:
        bad = classic.EALDataInfo_t(classic.INT, 2**40)
        assert old.setValue(old.findResource("SampleResource"), bad) == -1


def test_data_goes_in_as_python_values_or_eal_data() -> None:
    with connect() as eal:
        sample = eal.find_resource("SampleResource")
        for value in (5, EALData.of(5)):
            assert eal.set_value(sample, value) == 1
            assert eal.get_value(sample).value == 5
