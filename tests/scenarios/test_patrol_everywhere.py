"""One file, scenarios/patrol.yaml: on drivers whose emulators drive below a rendered camera, and over the network.

`test_new_scenarios` has it in the simulation.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.cli.emulators import EmulatorProcesses, open_devices
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.yaml_source import parse_yaml
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import Report, load_scenario, run_scenario
from plugins.camera.emulator import draw
from tests.net.links import free_port
from tests.net.rig import becomes, process, serving
from tests.patience import LONG_S

GUARDS = ("evbot2-1", "evbot3-1")
WIRES = {f"LAB_{wire}": "sim://world" for wire in ("EVBOT2", "EVBOT3", "ROOMBA", "CREATE")}
MARKERS = {"evbot2-1": 20, "evbot3-1": 30, "roomba-1": 10, "create-1": 11}


def patrol(fleet: Fleet, folder: Path) -> Report:
    scenario = load_scenario(bundled_path("scenarios/patrol.yaml"), {"laps": 2, "rest_s": 0.0})
    return run_scenario(scenario, fleet, directory=folder / "run")


def judge(report: Report, folder: Path, guards: tuple[str, ...]) -> None:
    assert (report.error, report.outcome) == (None, "done")
    shares = {guards[0]: ("northwest", "southwest"), guards[1]: ("northeast", "southeast")}
    for guard, places in shares.items():
        visited = [step.label for step in report.steps if step.robot == guard and step.kind == "visit"]
        assert visited == [f"visit {place}" for place in places * 2]
        for place in places:
            assert (folder / "run" / guard / f"1.{place}.png").is_file()


def lab(folder: Path, clock: object, addresses: Mapping[str, str] | None = None) -> Path:
    """Write the laboratory's fleet below the rendered camera; return its file."""
    (folder / "pictures").mkdir()
    draw(folder / "pictures")
    ceiling = parse_yaml(bundled_path("fleets/ceiling.yaml").read_text(), "ceiling").root["robots"]["cameras-1"]
    robots: dict[str, dict[str, Any]] = {
        name: {"pose": {"from": ["odometry", "cameras-1"], "marker": marker}, "timeout_s": LONG_S}
        for name, marker in MARKERS.items()
    }
    for guard in GUARDS:
        robots[guard] |= {"tags": ["guard"], "plugins": {"camera": {"source": str(folder / "pictures"), "loop": True}}}
    robots["cameras-1"] = dict(ceiling)
    if clock != "max":  # a busy machine may stop a real process for a second
        for guard in GUARDS:
            robots[guard]["plugins"][guard[:6]] = {"watchdog_s": 5}
    for name, address in (addresses or {}).items():
        robots[name] |= {"address": address}
    content = {"version": 1, "include": [str(bundled_path("fleets/lab.yaml"))], "clock": {"rate": clock}}
    content |= {
        "network": {"dead_man_s": 60.0, "lease_s": 60},
        "world": str(bundled_path("fleets/worlds/store.yaml")),
        "robots": robots,
    }
    file = folder / "guarded.yaml"
    file.write_text(json.dumps(content))
    return file


def judge_lab(fleet: Fleet, report: Report, folder: Path) -> None:
    last = {name: fleet[name].pose.get().get() for name in GUARDS}
    judge(report, folder, GUARDS)
    for guard, (x_m, y_m) in zip(GUARDS, ((-1.2, -1.8), (1.2, -1.8)), strict=True):
        assert math.dist((last[guard].x_m, last[guard].y_m), (x_m, y_m)) < 0.02


@pytest.mark.slow
def test_on_the_drivers_of_the_lab_below_a_rendered_camera(tmp_path: Path) -> None:
    """Four drivers speak their own protocols to emulators, which drive bodies with markers on the camera's floor."""
    with Fleet(EALConfigManager.load(lab(tmp_path, "max"), environment=WIRES).fleet) as fleet:
        judge_lab(fleet, patrol(fleet, tmp_path), tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(500)
def test_on_the_drivers_of_the_lab_in_another_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same drivers, emulators and camera are served by one process, in real time, and controlled from this one."""
    for name, value in WIRES.items():
        monkeypatch.setenv(name, value)
    addresses = {name: f"tcp/127.0.0.1:{free_port()}" for name in (*MARKERS, "cameras-1")}
    file = lab(tmp_path, 1, addresses)
    with one_process(file, addresses) as fleet:
        judge_lab(fleet, patrol(fleet, tmp_path), tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(500)
def test_on_the_emulators_of_the_lab_at_their_wires(tmp_path: Path) -> None:
    """As `eal lab patrol --fleet lab-world`: sockets, pseudo-terminals and a stream of pictures to one world."""
    watchdogs = {guard: {"plugins": {guard[:6]: {"watchdog_s": 5}}, "timeout_s": LONG_S} for guard in GUARDS}
    content = {"version": 1, "include": [str(bundled_path("fleets/lab-world.yaml"))], "robots": watchdogs}
    file = tmp_path / "busy.yaml"
    file.write_text(json.dumps(content))
    with EmulatorProcesses(open_devices(file), file) as emulators:
        with Fleet(EALConfigManager.load(file).fleet) as fleet:
            judge_lab(fleet, patrol(fleet, tmp_path), tmp_path)
        assert emulators.failures == {}
    for guard, place in zip(GUARDS, ((-1.2, -1.8), (1.2, -1.8)), strict=True):
        off_mm = 1000 * math.dist(emulators.poses[guard][:2], place)
        print(f"{guard} ends {off_mm:.1f} mm from its place")  # noqa: T201
        assert off_mm < 30


@contextmanager
def one_process(file: Path, robots: Iterable[str]) -> Iterator[Fleet]:
    """Serve robots of one world from one process; yield the fleet of their controller, which is another one."""
    names = list(robots)
    command = ["-m", "eal_actors", "serve", "--fleet", str(file), *(word for name in names for word in ("-r", name))]
    fleet = Fleet(EALConfigManager.load(file).fleet)
    with process(command, file.parent) as server, fleet.connect(names):
        for name in names:
            server.wait_for(f"{name} serves")
            assert becomes(fleet[name], RobotState.READY), server.lines
        yield fleet


@pytest.mark.slow
@pytest.mark.timeout(500)
def test_over_the_network(tmp_path: Path) -> None:
    """Each guard runs in a process of its own, and in a world of its own, so it has odometry only."""
    robots = {
        name: {"address": f"tcp/127.0.0.1:{free_port()}", "timeout_s": LONG_S, "pose": {"from": ["odometry"]}}
        for name in ("evbot3-1", "evbot3-2")
    }
    content = {"version": 1, "include": [str(bundled_path("fleets/patrol.yaml"))], "clock": {"rate": 2}}
    file = tmp_path / "served.yaml"
    file.write_text(json.dumps(content | {"network": {"dead_man_s": 60.0, "lease_s": 60}, "robots": robots}))
    fleet = Fleet(EALConfigManager.load(file).fleet)
    with serving(file, *robots), fleet.connect(robots):
        for name in robots:
            assert becomes(fleet[name], RobotState.READY)
            fleet[name]["Base"].set_config("max_uncertainty_m", 2.0).get()
        report = patrol(fleet, tmp_path)
        true = {name: fleet[name]["TruePose"].get_value().get().value for name in robots}
    judge(report, tmp_path, tuple(robots))
    for name, place in zip(robots, ((-1.2, -1.8), (1.2, -1.8)), strict=True):
        assert math.dist(true[name][:2], place) < 0.3, "by odometry alone"


@pytest.mark.slow
@pytest.mark.timeout(500)
def test_over_the_network_in_one_world_below_its_tracker(tmp_path: Path) -> None:
    """One process serves the simulated world, with both guards, the visitor and the tracker; this one controls."""
    names = ("evbot3-1", "evbot3-2", "roomba-1", "cameras-1")
    robots = {name: {"address": f"tcp/127.0.0.1:{free_port()}", "timeout_s": LONG_S} for name in names}
    content = {"version": 1, "include": [str(bundled_path("fleets/patrol.yaml"))], "clock": {"rate": 2}}
    file = tmp_path / "served.yaml"
    file.write_text(json.dumps(content | {"network": {"dead_man_s": 60.0, "lease_s": 60}, "robots": robots}))
    with one_process(file, names) as fleet:
        report = patrol(fleet, tmp_path)
        true = {name: fleet[name]["TruePose"].get_value().get().value for name in names[:2]}
        estimated = {name: fleet[name].pose.get().get() for name in names[:2]}
    judge(report, tmp_path, names[:2])
    for name, place in zip(names, ((-1.2, -1.8), (1.2, -1.8)), strict=False):
        off_mm = 1000 * math.dist(true[name][:2], place)
        print(f"{name} ends {off_mm:.1f} mm from its place")  # noqa: T201
        assert off_mm < 30
        assert estimated[name].position_std_m < 0.02, "the tracker's fixes reach it"
