"""The laboratory's fleet, `fleets/lab.yaml`: from the fleet file to the wheels of emulators, byte by byte."""

from __future__ import annotations

import math
import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from eal_actors.cli import emulators as emulators_module
from eal_actors.cli import readiness
from eal_actors.cli.emulators import EmulatorProcesses, LabDevice, open_devices
from eal_actors.cli.lab import commands, destination
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.errors import PreemptedError, UnavailableError
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.manifest import EmulatorSection, discover
from eal_actors.managers.twins import simulated
from eal_actors.operate.doctor.devices import NamedDevice, named_devices
from eal_actors.scenario import Report, load_scenario, run_scenario
from plugins.camera.emulator import PICTURES, draw
from tests.program import eal_processes

LAB = bundled_path("fleets/lab.yaml")
WIRES = {"LAB_EVBOT2": "evbot2-1", "LAB_EVBOT3": "evbot3-1", "LAB_ROOMBA": "roomba-1", "LAB_CREATE": "create-1"}
"""The variables, and the robot of each."""

BODIES = """\
version: 1
robots:
  evbot2-body: {plugins: {sim: {model: evbot2, noise: false, start: {x_m: -3, y_m: 0}}}}
  evbot3-body: {plugins: {sim: {model: evbot3, noise: false, start: {x_m: -1, y_m: 0}}}}
  roomba-body: {plugins: {sim: {model: roomba, noise: false, start: {x_m: 1, y_m: 0}}}}
  create-body: {plugins: {sim: {model: roomba, noise: false, start: {x_m: 3, y_m: 0}}}}
"""
FLEET = """\
version: 1
name: floor
include: [bodies.yaml, {lab}]
clock: {{rate: max}}
world: world.yaml
"""
WORLD = "version: 1\nname: world\nsize_m: [10.0, 6.0]\n"

COUNT_M = {"evbot2-1": 0.0005, "evbot3-1": 0.0002, "roomba-1": 0.001, "create-1": math.pi * 0.072 / 508.8}
"""The resolution of each robot's encoders."""
ARM_M = {"evbot2-1": 0.12, "evbot3-1": 0.15, "roomba-1": 0.129, "create-1": 0.129}
"""Distance from each robot's centre to its wheels."""
OFF_COUNTS = 2.0
"""Tolerance of a motion's end, in counts."""
STEP_M = 0.5
POLL_HZ = 20


def tolerance(robot: str, drives: int, turns: int) -> tuple[float, float]:
    """Return the largest error, in m and rad, if each motion ends within the resolution of the encoders."""
    turn_rad = OFF_COUNTS * COUNT_M[robot] / ARM_M[robot]
    return drives * (OFF_COUNTS * COUNT_M[robot] + STEP_M * turn_rad), turns * turn_rad


@pytest.fixture
def floor(tmp_path: Path) -> Iterator[Fleet]:
    """The laboratory's fleet: emulators drive robots on a simulated floor; the camera plays a recording."""
    (tmp_path / "pictures").mkdir()
    draw(tmp_path / "pictures")
    (tmp_path / "world.yaml").write_text(WORLD, encoding="utf-8")
    (tmp_path / "bodies.yaml").write_text(BODIES, encoding="utf-8")
    file = tmp_path / "fleet.yaml"
    file.write_text(FLEET.format(lab=LAB), encoding="utf-8")
    bodies = {variable: f"sim://world/{robot.replace('-1', '-body')}" for variable, robot in WIRES.items()}
    environment = {**bodies, "LAB_CAMERA": str(tmp_path / "pictures")}
    with Fleet(EALConfigManager.load(file, environment=environment).fleet) as fleet:
        yield fleet


def carry_out(fleet: Fleet, name: str) -> Report:
    """Run a shipped scenario on the robots with drivers."""
    scenario = load_scenario(bundled_path(f"scenarios/{name}.yaml"))
    (role,) = scenario.file.roles
    return run_scenario(scenario, fleet, binding={role: list(WIRES.values())})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "drives", "turns", "yaw_deg"), [("square", 8, 8, 0.0), ("dance", 0, 7, 45 - 90 + 90 - 10 + 10 - 10)]
)
def test_all_of_them_end_where_they_should(floor: Fleet, name: str, drives: int, turns: int, yaw_deg: float) -> None:
    starts = {robot: floor[robot.replace("-1", "-body")]["TruePose"].get_value().get().value for robot in COUNT_M}
    report = carry_out(floor, name)
    assert (report.outcome, {robot: end.outcome for robot, end in report.robots.items()}) == (
        "done",
        dict.fromkeys(COUNT_M, "done"),
    )
    for robot, start in starts.items():
        end = floor[robot.replace("-1", "-body")]["TruePose"].get_value().get().value
        off_m, off_rad = tolerance(robot, drives, turns)
        yaw_rad = math.radians(-yaw_deg)
        assert math.dist(end[:2], start[:2]) < off_m + 1e-3, robot
        assert abs(math.remainder(end[2] - start[2] - yaw_rad, math.tau)) < off_rad, robot
        believed = floor[robot]["Odometry"].get_value().get().value
        assert abs(math.remainder(believed[2] - yaw_rad, math.tau)) < off_rad, robot


@pytest.mark.parametrize("robot", COUNT_M)
def test_a_stop_stands_within_a_poll(floor: Fleet, robot: str) -> None:
    base, pose = floor[robot]["Base"], floor[robot.replace("-1", "-body")]["TruePose"]
    speed_m_s = base.get_config("speed_m_s").get().value
    start = pose.get_value().get().value
    driving = base.send_cmd("f3")
    floor.clock.sleep(1.0)
    before = pose.get_value().get().value
    assert math.dist(start[:2], before[:2]) > 0.1
    assert base.send_cmd("s").get() == 1
    assert isinstance(driving.exception(), PreemptedError)
    floor.clock.sleep(2.0)
    stopped = pose.get_value().get().value
    assert math.dist(before[:2], stopped[:2]) < speed_m_s / POLL_HZ
    floor.clock.sleep(2.0)
    assert pose.get_value().get().value == pytest.approx(stopped, abs=1e-9)


def test_the_camera_and_the_computer_of_the_first_are_there(floor: Fleet) -> None:
    assert floor["evbot2-1"]["Camera"].get_value().get().value.shape == (120, 160, 3)
    assert PICTURES > 1
    assert 0 <= floor["evbot2-1"]["Memory"].get_value().get().value <= 1


# The emulators as programs.

QUICK = """\
version: 1
name: quick
robots:
  tracks: {plugins: {evbot2: {port: "${LAB_ONE:-/dev/null/nowhere}", watchdog_s: 5, poll_hz: 5}}}
  turret: {plugins: {evbot3: {address: "${LAB_TWO:-udp://127.0.0.1:9}", watchdog_s: 5, poll_hz: 5}}}
  moted: {plugins: {roomba: {protocol: sci, link: mote, port: "${LAB_THREE:-/dev/null/nowhere}", poll_hz: 5}}}
  cabled: {plugins: {roomba: {protocol: oi, port: "${LAB_FOUR:-/dev/null/nowhere}", poll_hz: 5}}}
"""

NOD = """\
version: 1
name: nod
description: A little way and a little turn.
roles: {all: {}}
timeout_s: 60
steps:
  - on: all
    do:
      - send_cmd: {resource: Base, cmd: f0.1}
      - send_cmd: {resource: Base, cmd: "l${ANGLE}"}
"""


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Callable[[str], subprocess.Popen[str]]]:
    """Start `eal lab` in a process of its own; the robots turn by the given degrees."""
    (tmp_path / "fleet.yaml").write_text(QUICK, encoding="utf-8")
    with eal_processes(tmp_path) as start_eal:

        def start(angle_deg: str) -> subprocess.Popen[str]:
            (tmp_path / "nod.yaml").write_text(NOD.replace("${ANGLE}", angle_deg), encoding="utf-8")
            return start_eal("lab", "nod.yaml", "--fleet", "fleet.yaml", environment={**os.environ, "NO_COLOR": "1"})

        yield start


def test_the_lab_tells_what_it_started_and_where_the_robots_got_to(lab: Callable[[str], subprocess.Popen[str]]) -> None:
    out, err = lab("15").communicate()
    started = {line.partition(":")[0]: line for line in err.splitlines() if "emulated" in line}
    assert sorted(started) == ["cabled", "moted", "tracks", "turret"], out + err
    for robot in ("cabled", "moted", "tracks"):
        port = started[robot].split(" at ")[1].partition(",")[0]
        assert Path(port).name == "tty"
    poses = {line.split()[0]: line for line in out.splitlines() if "mm, " in line}
    assert sorted(poses) == ["cabled", "moted", "tracks", "turret"], out + err
    for line in poses.values():
        assert "0.100 m, 0.000 m, 15.0°" in line
        off_mm, off_deg = line.split()[-3], line.split()[-1].rstrip("°")
        assert float(off_mm) < 30
        assert float(off_deg) < 10


def when_all_turn(lab: Callable[[str], subprocess.Popen[str]]) -> subprocess.Popen[str]:
    """Start the lab with turns that take minutes; return its process once all four robots turn."""
    process = lab("3000")
    assert process.stdout is not None
    begun = 0
    for line in process.stdout:
        begun += "Base l3000" in line
        if begun == 4:
            break
    return process


@pytest.mark.parametrize(
    "number",
    [
        pytest.param(signal.SIGINT, marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, marks=pytest.mark.slow),
        signal.SIGKILL,
    ],
)
def test_no_emulator_outlives_the_lab(lab: Callable[[str], subprocess.Popen[str]], number: signal.Signals) -> None:
    process = when_all_turn(lab)
    process.send_signal(number)
    out, err = process.communicate(timeout=60)  # ends once all emulators, which inherited stderr, have ended
    assert process.returncode == {signal.SIGKILL: -signal.SIGKILL}.get(number, 130), out + err
    assert "Traceback" not in err, err
    if number != signal.SIGKILL:
        assert "nod on quick: aborted" in out
        assert out.count("unknown") == 4


def test_the_row_of_a_robot_whose_emulator_died_has_the_reason(lab: Callable[[str], subprocess.Popen[str]]) -> None:
    process = when_all_turn(lab)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    (emulator,) = [pid for pid in children if words(pid)[3:4] == [b"evbot2"]]
    os.kill(int(emulator), signal.SIGKILL)
    while Path(f"/proc/{emulator}/stat").read_text().split()[2] != "Z":
        pass
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    row = next(line for line in out.splitlines() if line.startswith("tracks") and "emulator" in line)
    assert "the emulator of evbot2 was killed by SIGKILL" in row, out + err
    assert out.count("unknown") == 4


def words(pid: str) -> list[bytes]:
    """Return the command line of a process."""
    return Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")


def test_a_wire_whose_variable_is_set_is_the_robot_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in (*WIRES, "LAB_CAMERA"):
        monkeypatch.delenv(variable, raising=False)
    found = {
        variable: (device.robot, device.plugin.name)
        for device in open_devices(LAB)
        for variable in device.variables.values()
    }
    assert {variable: robot for variable, (robot, _) in found.items()} == {**WIRES, "LAB_CAMERA": "evbot2-1"}
    assert {plugin for _, plugin in found.values()} == {"evbot2", "evbot3", "roomba", "camera"}
    monkeypatch.setenv("LAB_EVBOT2", "/dev/ttyUSB0")
    assert {"port": "LAB_EVBOT2"} not in [device.variables for device in open_devices(LAB)]


def test_an_emulator_that_does_not_start_is_named(capfd: pytest.CaptureFixture[str]) -> None:
    manifests, _ = discover([])
    without = manifests["evbot2"].file.model_copy(update={"emulator": EmulatorSection(arguments=())})
    devices = [
        LabDevice("lost", replace(manifests["evbot2"], file=without), {"port": "LAB_LOST"}, {}),
        LabDevice("there", manifests["evbot3"], {"address": "LAB_THERE"}, {}),
    ]
    with pytest.raises(UnavailableError, match="lost: its emulator has ended"), EmulatorProcesses(devices):
        pass
    assert "required: --pty" in capfd.readouterr().err
    assert "LAB_THERE" not in os.environ


FOREIGN_MANIFEST = """\
version: 1
name: lift
description: A lift of somebody else.
plugin_version: "1"
resources: [Base]
uses: [evbot2]
twin: {plugin: sim, settings: {model: evbot3}}
emulator: {module: device, settings: {port: "{address}"}, arguments: [--slow], options: {floor: {two: [--two]}}}
devices: [{setting: port, kind: serial, usb: ["1234:abcd"], group: lifters}]
"""
FOREIGN_DEVICE = """\
import signal
import sys
import threading
from ..evbot2.protocol import BAUD_RATE
from .words import ENDING
ended = threading.Event()
signal.signal(signal.SIGTERM, lambda *_: ended.set())
print("port of", *sys.argv[1:], BAUD_RATE, flush=True)
ended.wait()
print(ENDING)
"""


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """Write a third-party plugin and a fleet that finds it."""
    folder = tmp_path / "theirs" / "lift"
    folder.mkdir(parents=True)
    (folder / "plugin.yaml").write_text(FOREIGN_MANIFEST, encoding="utf-8")
    (folder / "device.py").write_text(FOREIGN_DEVICE, encoding="utf-8")
    (folder / "words.py").write_text("ENDING = 'pose 1.0 m 2.0 m 90.0 deg'\n", encoding="utf-8")
    file = tmp_path / "fleet.yaml"
    file.write_text(
        "version: 1\nplugin_dirs: [theirs]\n"
        "robots: {one: {plugins: {lift: {floor: two, port: '${LAB_LIFT:-/dev/no-such-port}'}}}}\n",
        encoding="utf-8",
    )
    return file


def test_a_plugin_from_elsewhere_is_emulated(foreign: Path) -> None:
    (device,) = open_devices(foreign)
    assert (device.robot, device.plugin.name, device.variables) == ("one", "lift", {"port": "LAB_LIFT"})
    with EmulatorProcesses([device]) as emulators:
        assert emulators.addresses == {"LAB_LIFT": "port of --slow --two 115200"}
    assert emulators.poses == {"one": (1.0, 2.0, 90.0)}


def test_an_emulator_that_says_nothing_is_not_waited_for(foreign: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (foreign.parent / "theirs/lift/device.py").write_text("import sys\nsys.stdin.read()\n", encoding="utf-8")
    monkeypatch.setattr(readiness, "START_S", 0.1)
    emulators = EmulatorProcesses(open_devices(foreign))
    with (
        pytest.raises(UnavailableError, match=r"one: its emulator was not ready within 0\.1 s, and was killed"),
        emulators,
    ):
        pass


LEAVES_A_CHILD = """\
import os
import subprocess
child = subprocess.Popen(["sleep", "600"])
print(os.getpid(), flush=True)
child.wait()
"""


def test_the_child_of_a_killed_emulator_is_not_waited_for(foreign: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It has the emulator's output open, and `make lab` waited for the end of that for ever."""
    (foreign.parent / "theirs/lift/device.py").write_text(LEAVES_A_CHILD, encoding="utf-8")
    monkeypatch.setattr(emulators_module, "_STOP_S", 0.1)
    with EmulatorProcesses(open_devices(foreign)) as emulators:
        os.kill(int(emulators.addresses["LAB_LIFT"]), signal.SIGKILL)
    assert emulators.poses == {}


ECHO_FLEET = """\
version: 1
robots:
  one: {plugins: {serial_port: {port: "${LAB_ONE:-/dev/no-such-port}"}}}
  two:
    plugins:
      socket_port:
        host: ${LAB_HOST:-nowhere}
        port: ${LAB_PORT:-9}
"""


def test_an_emulator_that_is_no_program_is_served_on_its_wire(tmp_path: Path) -> None:
    file = tmp_path / "fleet.yaml"
    file.write_text(ECHO_FLEET, encoding="utf-8")
    devices = open_devices(file)
    assert [device.variables for device in devices] == [{"port": "LAB_ONE"}, {"host": "LAB_HOST", "port": "LAB_PORT"}]
    with EmulatorProcesses(devices) as emulators:
        assert emulators.addresses["LAB_HOST"] == "127.0.0.1"
        with Fleet(EALConfigManager.load(file).fleet) as fleet:
            for robot, resource in (("one", "SerialPort"), ("two", "SocketPort")):
                fleet[robot][resource].write_comm("hello").get()
                assert fleet[robot][resource].read_comm(5).get().value == b"hello"
    assert (emulators.poses, emulators.failures) == ({}, {})


def test_a_plugin_from_elsewhere_has_a_twin_and_devices(foreign: Path) -> None:
    config = EALConfigManager.load(foreign, environment={}).fleet
    twins = simulated(config, ["one"])
    assert twins.replaced == {"one": "simulated by sim (model: evbot3) in place of lift"}
    assert twins.config.robots["one"].plugins["sim"].settings == {"model": "evbot3"}
    with Fleet(twins.config) as fleet:
        assert "Turret" in fleet["one"]
    (device,) = named_devices(config.robots.values(), discover(config.plugin_dirs)[0])
    assert device == NamedDevice("one", Path("/dev/no-such-port"), "serial", usb=("1234:abcd",), group="lifters")


def test_where_commands_lead() -> None:
    square = ["g", "r"] * 4 + ["s"] + ["l", "b"] * 4
    assert destination(square) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert destination(["l90", "f0.2", "r45", "b1"]) == pytest.approx((-math.sqrt(0.5), 0.2 - math.sqrt(0.5), 45.0))
    assert destination(["r360", "l10", "unknown"]) == pytest.approx((0.0, 0.0, 10.0))


def test_a_run_that_was_cut_short_leads_nobody_knows_where(tmp_path: Path) -> None:
    step = '{"robot": "one", "resource": "Base", "command": "%s", "start_s": %d, "outcome": "%s", "attempts": 1}'
    (tmp_path / "first").mkdir()
    done = ", ".join([step % ("r45", 2, "done"), step % ("g", 1, "done")])
    (tmp_path / "first" / "summary.json").write_text(f'{{"steps": [{done}]}}', encoding="utf-8")
    assert commands("one", [tmp_path / "first"]) == ["g", "r45"]
    assert commands("two", [tmp_path / "first"]) == []
    (tmp_path / "second").mkdir()
    assert commands("one", [tmp_path / "first", tmp_path / "second"]) is None
    failed = step % ("g", 1, "failed")
    (tmp_path / "second" / "summary.json").write_text(f'{{"steps": [{failed}]}}', encoding="utf-8")
    assert commands("one", [tmp_path / "first", tmp_path / "second"]) is None
