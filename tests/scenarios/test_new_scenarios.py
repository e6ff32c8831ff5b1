"""Formation, patrol, search and relay, in lock step on their fleets: by estimated poses, judged by the true ones."""

from __future__ import annotations

import ast
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from eal_actors import RobotHandle
from eal_actors.device.world import Formation, formation_poses, load_world
from eal_actors.kernel.bundled import bundled_path
from eal_actors.recording import PoseRecorder
from eal_actors.recording.poses import PoseSample
from eal_actors.scenario import LogLine, Report, RunEvent, load_scenario, run_scenario
from eal_actors.testing import Simulation
from scenarios import patrol as patrol_py
from scenarios import relay as relay_py
from scenarios import search as search_py

RADII_M = {"evbot2": 0.18, "evbot3": 0.20, "roomba": 0.17}
MARGIN_M = 0.05
"""Of the 10 cm that are planned, after the errors of the poses."""


@pytest.mark.parametrize("name", ["formation", "patrol", "relay", "search"])
def test_the_files_are_short_and_know_no_true_pose(name: str) -> None:
    """The files in YAML hold no sums either."""
    for suffix in ("yaml", "py"):
        text = bundled_path(f"scenarios/{name}.{suffix}").read_text(encoding="utf-8")
        assert "TruePose" not in text
    text = bundled_path(f"scenarios/{name}.yaml").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 25
    for _, step in load_scenario(bundled_path(f"scenarios/{name}.yaml")).file.walk():
        for located in step.expressions():
            nodes = ast.walk(located.expression.tree or ast.Constant(0))
            assert not any(isinstance(node, ast.BinOp) for node in nodes), located.expression.text


def fleet_file(name: str) -> Path:
    return bundled_path(f"fleets/{name}.yaml")


def run(
    simulation: Simulation, name: str, directory: Path | None = None, **parameters: Any
) -> tuple[Report, list[str]]:
    """Run a shipped scenario; return its report and its log lines, each with its robot."""
    said: list[str] = []

    def listen(event: RunEvent) -> None:
        if isinstance(event, LogLine):
            said.append(f"{event.robot}: {event.text}" if event.robot else event.text)

    scenario = load_scenario(bundled_path(f"scenarios/{name}.yaml"))
    report = run_scenario(scenario, simulation.fleet, directory=directory, parameters=parameters, listeners=[listen])
    return report, said


def message(report: Report) -> str:
    assert report.error is not None
    return report.error.message


def by_odometry(folder: Path, name: str) -> Path:
    """Write a shipped fleet whose robots have odometry only: nobody asks its camera for pictures, which take long."""
    pose = "{pose: {from: [odometry]}}"
    file = folder / f"{name}.yaml"
    file.write_text(
        f"version: 1\ninclude: ['{fleet_file(name)}']\ntypes: {{evbot2: {pose}, evbot3: {pose}, roomba: {pose}}}\n",
        encoding="utf-8",
    )
    return file


# Formation.


def robots_of(simulation: Simulation) -> list[str]:
    return [name for name in simulation.fleet if "Base" in simulation[name]]


def least_gap_m(paths: Mapping[str, Sequence[PoseSample]]) -> float:
    """Return the least distance between the hulls of any two robots."""
    gaps_m = [9.0]
    at = {name: {sample.time_s: (sample.x_m, sample.y_m) for sample in path} for name, path in paths.items()}
    for one, other in itertools.combinations(at, 2):
        radii_m = RADII_M[one.partition("-")[0]] + RADII_M[other.partition("-")[0]]
        gaps_m += [math.dist(at[one][time_s], at[other][time_s]) - radii_m for time_s in at[one].keys() & at[other]]
    return min(gaps_m)


def worst_m(simulation: Simulation, rule: Formation) -> float:
    """Return the largest distance of a robot from its place in a shape."""
    at = [simulation.pose(name)[:2] for name in robots_of(simulation)]
    return max(min(math.dist((place.x_m, place.y_m), point) for point in at) for place in formation_poses(rule))


@pytest.mark.slow
def test_a_shape_is_formed_without_near_misses() -> None:
    with (
        Simulation(fleet_file("formation")) as simulation,
        PoseRecorder(simulation.fleet, robots_of(simulation)) as recorder,
    ):
        report, _ = run(simulation, "formation", shape="wedge", spacing_m=0.8)
        assert (report.error, report.outcome) == (None, "done")
        assert worst_m(simulation, Formation(shape="wedge", count=9, spacing_m=0.8)) <= 0.02
    assert least_gap_m(recorder.paths_since(0)) >= MARGIN_M


def test_a_shape_that_is_too_narrow_is_refused_before_a_robot_moves(tmp_path: Path) -> None:
    with Simulation(by_odometry(tmp_path, "formation")) as simulation:
        before = {name: simulation.pose(name) for name in robots_of(simulation)}
        report, _ = run(simulation, "formation", spacing_m=0.35)
        assert {name: simulation.pose(name) for name in before} == before
    assert report.outcome == "failed"
    assert "these robots need" in message(report)


def test_a_robot_that_cannot_reach_its_place_fails_the_formation(tmp_path: Path) -> None:
    with Simulation(by_odometry(tmp_path, "formation")) as simulation:
        simulation.inject("roomba-1", stuck_left=True, stuck_right=True)
        report, _ = run(simulation, "formation")
    assert report.outcome == "failed"
    assert "roomba-1" in message(report)


# Patrol.


@pytest.mark.slow
def test_the_patrol_reports_moved_things_and_ignores_noise(tmp_path: Path) -> None:
    with Simulation(fleet_file("patrol")) as simulation:
        for guard in ("evbot3-1", "evbot3-2"):
            simulation[guard]["Camera"].set_config("noise", 5.0).get()
        report, said = run(simulation, "patrol-visit", tmp_path)
    assert (report.error, report.outcome) == (None, "done")
    assert sorted(path.name for path in (tmp_path / "evbot3-2").glob("changed.*")) == [
        "changed.1.northeast.png",
        "changed.1.southeast.png",
    ]
    assert not list((tmp_path / "evbot3-1").glob("changed.*")), "nobody moved the crate that it looks at"
    assert said == [
        "evbot3-2: 1.northeast.png is not as 0.northeast.png: see changed.1.northeast.png",
        "evbot3-2: 1.southeast.png is not as 0.southeast.png: see changed.1.southeast.png",
    ]


@pytest.mark.slow
def test_the_patrol_in_python_reports_moved_things() -> None:
    with Simulation(fleet_file("patrol")) as simulation:

        def visit(visitor: RobotHandle) -> None:
            simulation.fleet.clock.sleep(24.0)
            for command in ("f2.4", "b2.4"):
                visitor["Base"].send_cmd(command).get()

        with simulation.fleet.tasks() as tasks:
            tasks.start(visit, simulation["roomba-1"])
            changes = patrol_py.patrol(simulation.fleet, laps=2)
        places = {name: simulation.pose(name) for name in robots_of(simulation)}
        simulation.advance(5)
        assert {name: simulation.pose(name) for name in places} == places, "all stand"
    assert changes == [("evbot3-2", 1, "northeast"), ("evbot3-2", 1, "southeast")]


# Search.


def hall_with_a_beacon(x_m: float, y_m: float, reach_m: float) -> dict[str, Any]:
    """The hall of the search, with its lanes and its camera, and the beacon elsewhere."""
    world = load_world(bundled_path("fleets/worlds/search.yaml")).model_dump(mode="json", exclude_defaults=True)
    beacon = {"name": "lost", "x_m": x_m, "y_m": y_m, "reach_m": reach_m}
    return {**world, "version": 1, "beacons": [beacon]}


@pytest.mark.parametrize(
    ("x_m", "y_m", "finder"),
    [pytest.param(2.9, 1.9, "roomba-2", marks=pytest.mark.slow), (-3.0, -2.4, "evbot3-1")],
)
def test_the_first_to_hear_the_beacon_stops_the_rest(x_m: float, y_m: float, finder: str) -> None:
    with Simulation(fleet_file("search"), hall_with_a_beacon(x_m, y_m, 0.9)) as simulation:
        report, said = run(simulation, "search")
        places = {name: simulation.pose(name) for name in robots_of(simulation)}
        simulation.advance(5)
        assert {name: simulation.pose(name) for name in places} == places, "all stand"
    assert (report.error, report.outcome) == (None, "done")
    (line,) = said
    assert line.startswith(f"{finder}: hears beacon 0, 0.")
    assert math.dist(places[finder][:2], (x_m, y_m)) <= 0.9
    stopped = {step.robot for step in report.steps if step.outcome == "stopped" and step.kind == "wait_until"}
    assert stopped == set(places) - {finder}


@pytest.mark.slow
def test_a_beacon_out_of_range_is_not_found() -> None:
    with Simulation(fleet_file("search"), hall_with_a_beacon(4.9, 3.9, 0.2)) as simulation:
        report, said = run(simulation, "search")
    assert report.outcome == "failed"
    assert message(report).startswith("nobody found beacon 0: ")
    assert said == []


def test_search_in_python(tmp_path: Path) -> None:
    with Simulation(by_odometry(tmp_path, "search"), hall_with_a_beacon(-3.0, -2.4, 0.9)) as simulation:
        finding = search_py.search(simulation.fleet)
        assert [simulation[name]["Base"].get_status().get() for name in robots_of(simulation)] == [0] * 4
    assert finding is not None
    assert finding[0] == "evbot3-1"
    assert finding[1] <= 0.9


# Relay.


@contextmanager
def runners(*charges: float, **settings: Any) -> Iterator[Simulation]:
    """Robots in the bays of the hall, with odometry only, which may be as wrong as it likes."""
    robots = {
        f"r{number}": {"model": "roomba", "charge": charge, "start": (x_m, -3.4, 90), **settings}
        for number, (x_m, charge) in enumerate(zip((-2.0, 0.0, 2.0), charges, strict=False))
    }
    with Simulation(robots, bundled_path("fleets/worlds/hall.yaml")) as simulation:
        for name in robots:
            simulation[name]["Base"].set_config("max_uncertainty_m", 2.0).get()
        yield simulation


@pytest.mark.slow
def test_the_relay_of_the_shipped_fleet_goes_round_twice() -> None:
    with Simulation(fleet_file("relay")) as simulation:
        report, said = run(simulation, "relay")
        assert (report.error, report.outcome) == (None, "done")
        assert all(abs(simulation.pose(name)[1] + 3.4) < 0.02 for name in robots_of(simulation)), "all are home"
    assert said[-1].startswith("roomba-3: 0 marks are left, ")


def test_each_runner_continues_where_the_last_one_stopped() -> None:
    with runners(0.2008, 0.202, 1.0) as simulation:
        report, said = run(simulation, "relay", laps=1)
        left = float(simulation["r0"]["Battery"].get_value().get().value)
        homes = [simulation[name].pose.get().get() for name in robots_of(simulation)]
        assert all(abs(home.y_m + 3.4) < 0.02 for home in homes), "all believe to be home"
    assert (report.error, report.outcome) == (None, "done")
    driven = [(step.robot, step.label) for step in report.steps if step.label.startswith("go_to mark")]
    assert [label for _, label in driven] == [f"go_to mark-{number}" for number in range(1, 13)]
    assert [robot for robot, _ in itertools.groupby(robot for robot, _ in driven)] == ["r0", "r1", "r2"]
    assert 0.19 < left < 0.2, "it was low, and came home on what was left"
    first, second = (
        [step for step in report.steps if (step.robot, step.kind) == (name, "go_to")] for name in ("r0", "r1")
    )
    assert second[0].start_s >= first[-1].end_s, "the second sets out when the first is home"
    assert (first[-1].label, second[-1].label) == ("go_to bay-1", "go_to bay-2")
    assert said[-1].startswith("r2: 0 marks are left, ")


def test_when_every_battery_is_low_the_relay_reports_its_progress() -> None:
    with runners(0.19, 0.19) as simulation:
        report, _ = run(simulation, "relay", laps=9)
    assert report.outcome == "failed"
    assert message(report).startswith("every battery is low, with 108 marks left")


def test_a_runner_whose_battery_dies_on_the_way_ends_the_relay() -> None:
    with runners(1.0, 1.0, faults=[{"at_s": 10.0, "battery_empty": True}]) as simulation:
        report, _ = run(simulation, "relay")
    assert {name: robot.outcome for name, robot in report.robots.items()} == {"r0": "failed", "r1": "aborted"}
    assert "battery is empty" in message(report)


def test_relay_in_python() -> None:
    with runners(0.2008, 0.202, 1.0) as simulation:
        done = relay_py.relay(simulation.fleet, 1)
    assert sum(done.values()) == 12
    assert min(done.values()) > 0
