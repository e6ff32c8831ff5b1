"""Each wire check finds its mistake: a correct driver with an emulator is broken in one place at a time."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Final

import pytest

from eal_actors.device.emulator_wires import UdpWire
from eal_actors.testing.conformance import CHECKS, Bench, CheckResult, run_check, settings_of

WIRING: Final = (
    "starts",
    "separates concurrent calls",
    "waits for its device",
    "survives unplugging",
    "leaves no thread",
    "releases its ports",
    "reconnects",
)

MANIFEST: Final = """\
version: 1
name: pair
description: Two meters on one port.
plugin_version: "1"
resources: [Left, Right]
emulator: {wire: pty, settings: {port: "{address}"}}
"""

PLUGIN: Final = '''\
"""Two meters on one port."""

import threading

from eal_actors.plugin import EALPlugin, PluginSettingsModel, ReopeningPort, Resource, ResourceType, open_serial


class Settings(PluginSettingsModel):
    port: str


class Pair(EALPlugin):
    def __init__(self, port):
        super().__init__("Left", "Right")
        self.port = port
        self.both = threading.Barrier(2)


class Meter(Resource):
    """A meter."""

    types = ResourceType.SENSOR
    letter = b""

    def __init__(self, plugin):
        self.plugin = plugin

    def not_ready(self):
        return self.plugin.port.why_not_ready()

    def get_value(self):
        """Return what it shows."""
        return self.plugin.port.write(self.letter * 4 + b"\\n")

    def background(self):
        while True:
            try:
                self.plugin.port.read()
            except ConnectionError:
                pass
            yield 0.05


class Left(Meter):
    """The left one."""

    letter = b"l"


class Right(Meter):
    """The right one."""

    letter = b"r"


def connect(context):
    port = ReopeningPort(lambda: open_serial(context.settings.port, baudrate=9600), context.clock, "the port")
    port.open()
    return Pair(port)


def disconnect(plugin):
    plugin.port.close()


def create_Left(context):
    return Left(context.plugin)


def create_Right(context):
    return Right(context.plugin)


def destroy_Left(resource):
    pass


def destroy_Right(resource):
    pass
'''

EMULATOR: Final = '''\
"""A device that hears lines of four equal letters."""


class Emulator:
    def __init__(self):
        self.complaints = []
        self.line = b""

    def feed(self, data, now_s):
        self.line += data
        *lines, self.line = self.line.split(b"\\n")
        self.complaints += [repr(line) for line in lines if line not in (b"llll", b"rrrr")]
        return b""


def emulate(settings, now_s):
    return Emulator()
'''


@pytest.fixture
def pair(tmp_path: Path) -> Path:
    folder = tmp_path / "pair"
    folder.mkdir()
    for name, text in (("plugin.yaml", MANIFEST), ("plugin.py", PLUGIN), ("emulator.py", EMULATOR)):
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def run(folder: Path, name: str, ready_within_s: float = 15.0) -> CheckResult:
    (check,) = (check for check in CHECKS if check.name == name)
    return run_check(check, Bench(folder, settings_of({}), ready_within_s=ready_within_s))


@pytest.mark.parametrize("name", WIRING)
def test_a_good_driver_passes(pair: Path, name: str) -> None:
    assert run(pair, name) == CheckResult(next(check for check in CHECKS if check.name == name), "ok")


def test_a_resource_that_is_left_out_is_not_unplugged(pair: Path) -> None:
    (check,) = (check for check in CHECKS if check.name == "survives unplugging")
    result = run_check(check, Bench(pair, settings_of({}), left_out=frozenset({"Left"})))
    assert result == CheckResult(check, "ok")


MISTAKES = {
    "says nothing when it comes up": (
        "waits for its device",
        "return self.plugin.port.why_not_ready()",
        "return None",
        "its device is absent, but no resource reports that it is not ready",
    ),
    "says nothing when it is pulled out": (
        "survives unplugging",
        "return self.plugin.port.why_not_ready()",
        "return None",
        "its device was unplugged, but no resource reports that it is not ready",
    ),
    "does not come up without its device": (
        "waits for its device",
        "    port.open()\n",
        "    open_serial(context.settings.port, baudrate=9600).close()\n    port.open()\n",
        "connect raised SerialException: ",
    ),
    "halts with a bug when it is pulled out": (
        "survives unplugging",
        "    def not_ready(self):\n",
        "    def halt(self):\n        assert self.not_ready() is None\n\n    def not_ready(self):\n",
        "halt failed: resource_fault",
    ),
    "writes a line in two pieces": (
        "separates concurrent calls",
        '        return self.plugin.port.write(self.letter * 4 + b"\\n")\n',
        (
            "        self.plugin.port.write(self.letter * 2)\n        self.plugin.both.wait(9)\n"
            '        return self.plugin.port.write(self.letter * 2 + b"\\n")\n'
        ),
        "the emulator received invalid input",
    ),
    "keeps a file": (
        "releases its ports",
        "def connect(context):\n",
        "_KEPT = []\n\n\ndef connect(context):\n    _KEPT.append(open(__file__))\n",
        "is still open after close: ",
    ),
}


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")  # a kept file
@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_found(pair: Path, mistake: str) -> None:
    name, before, after, words = MISTAKES[mistake]
    assert before in PLUGIN
    (pair / "plugin.py").write_text(PLUGIN.replace(before, after), encoding="utf-8")
    result = run(pair, name, ready_within_s=0.6)
    assert result.outcome == "failed"
    assert words in "\n".join(result.problems)


def test_settings_that_name_a_device_get_no_stand_in(pair: Path) -> None:
    (check,) = (check for check in CHECKS if check.name == "survives unplugging")
    result = run_check(check, Bench(pair, settings_of({"port": "/nowhere/tty"})))
    assert (result.outcome, result.problems) == ("skipped", (check.nothing,))


@pytest.mark.parametrize(
    ("file", "before", "after", "words"),
    [
        (
            "emulator.py",
            "def emulate(",
            "def imitate(",
            "plugin 'pair': emulator emulator.py: AttributeError: .* has no attribute 'emulate'",
        ),
        ("plugin.yaml", "emulator: {", "emulator: {module: device, ", "emulator: there is no device.py in "),
        ("plugin.yaml", "emulator: {", "twin: {plugin: sample}\nemulator: {", "twin: .* declares no simulation; if"),
        (
            "plugin.yaml",
            "emulator: {",
            "twin: {plugin: sim, settings: {model: romba}}\nemulator: {",
            "twin: settings: model: .* did you mean 'roomba'",
        ),
        ("plugin.yaml", "emulator: {", "bridge: arch\nemulator: {", "bridge: there is no arch.py"),
        ("plugin.yaml", "emulator: {", "twin: {plugin: symu}\nemulator: {", "twin: unknown plugin 'symu'"),
    ],
)
def test_a_wrong_declaration_is_named(pair: Path, file: str, before: str, after: str, words: str) -> None:
    (pair / file).write_text((pair / file).read_text(encoding="utf-8").replace(before, after), encoding="utf-8")
    result = run(pair, "starts")
    assert result.outcome == "failed"
    assert any(_matches(words, problem) for problem in result.problems), result.problems


def test_a_plugin_of_ones_own_may_be_the_twin(pair: Path) -> None:
    twin = pair.parent / "paper"
    twin.mkdir()
    (twin / "plugin.yaml").write_text(MANIFEST.split("emulator")[0].replace("pair", "paper") + "simulation: {}\n")
    (pair / "plugin.yaml").write_text(MANIFEST + "twin: {plugin: paper}\n", encoding="utf-8")
    assert run(pair, "starts").outcome == "ok"


def test_why_a_plugin_does_not_connect_is_said_once(pair: Path) -> None:
    (pair / "plugin.py").write_text(PLUGIN.replace("    port.open()\n", "    1 / 0\n"), encoding="utf-8")
    (problem,) = run(pair, "starts").problems
    assert problem.startswith("plugin 'pair': connect raised ZeroDivisionError: division by zero (at pair/plugin.py:")


def test_a_hook_of_before_is_refused(pair: Path) -> None:
    (pair / "emulator.py").rename(pair / "conformance.py")
    (pair / "plugin.yaml").write_text(MANIFEST.replace("emulator:", "# emulator:"), encoding="utf-8")
    result = run(pair, "starts")
    assert "conformance.py is not read; declare `emulator` in plugin.yaml" in result.problems


def _matches(words: str, text: str) -> bool:
    start, _, end = words.partition(".*")
    return text.startswith(start) and end in text


class Shout:
    def feed(self, data: bytes, now_s: float) -> bytes:
        return data.upper()


def test_a_udp_wire_answers_and_vanishes_and_comes_back() -> None:
    wire = UdpWire(Shout)
    host, _, port = wire.address.partition(":")
    with socket.socket(type=socket.SOCK_DGRAM) as driver:
        driver.settimeout(10)
        driver.connect((host, int(port)))
        for _ in range(2):
            wire.plug_in()
            driver.send(b"hello")
            assert driver.recv(100) == b"HELLO"
            wire.unplug()
        driver.send(b"gone")
        with pytest.raises(ConnectionRefusedError):
            driver.recv(100)
    wire.close()
