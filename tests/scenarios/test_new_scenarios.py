"""Formation, patrol, search and relay, in lock step on their fleets."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from eal_actors import RobotHandle, gather
from eal_actors.device.world.model import Formation, formation_poses
from eal_actors.kernel.bundled import bundled_path
from eal_actors.lab.choreography.aiming import leg_commands
from eal_actors.recording import PoseRecorder
from eal_actors.recording.poses import PoseSample
from eal_actors.scenario import LogLine, Report, RunEvent, load_scenario, run_scenario
from eal_actors.testing import Simulation
from scenarios import formation as formation_py
from scenarios import patrol as patrol_py
from scenarios import relay as relay_py
from scenarios import search as search_py

RADII_M = {"evbot2": 0.18, "evbot3": 0.20, "roomba": 0.17}
MARGIN_M = 0.10
Robots = dict[str, dict[str, Any]]


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


# Formation.


def scattered(count: int, room_m: tuple[float, float], seed: int) -> Robots:
    """Robots of all makes at random places of a room, at least 65 cm apart (centres)."""
    generator = random.Random(seed)  # noqa: S311  # no secret
    starts: list[tuple[float, float, float]] = []
    while len(starts) < count:
        x_m, y_m = (generator.uniform(0.5 - size_m / 2, size_m / 2 - 0.5) for size_m in room_m)
        if all(math.dist((x_m, y_m), other[:2]) >= 0.65 for other in starts):
            starts.append((x_m, y_m, generator.uniform(-180, 180)))
    models = itertools.cycle(RADII_M)
    return {f"r{number}": {"model": next(models), "start": start} for number, start in enumerate(starts)}


def least_gap_m(paths: Mapping[str, Sequence[PoseSample]], robots: Robots) -> float:
    """Return the least distance between the hulls of any two robots."""
    gaps_m = [9.0]
    at = {name: {sample.time_s: (sample.x_m, sample.y_m) for sample in path} for name, path in paths.items()}
    for one, other in itertools.combinations(at, 2):
        radii_m = RADII_M[robots[one]["model"]] + RADII_M[robots[other]["model"]]
        gaps_m += [math.dist(at[one][time_s], at[other][time_s]) - radii_m for time_s in at[one].keys() & at[other]]
    return min(gaps_m)


@contextmanager
def watched(robots: Robots, room_m: tuple[float, float], seed: int) -> Iterator[tuple[Simulation, PoseRecorder]]:
    world = {"version": 1, "name": "hall", "size_m": list(room_m)}
    with Simulation(robots, world, seed=seed) as simulation, PoseRecorder(simulation.fleet, robots, 0.1) as recorder:
        yield simulation, recorder


def worst_m(simulation: Simulation, rule: Formation) -> float:
    """Return the largest distance of a robot from its place in a shape."""
    at = [simulation.pose(name)[:2] for name in simulation.fleet]
    return max(min(math.dist((place.x_m, place.y_m), point) for point in at) for place in formation_poses(rule))


@pytest.mark.parametrize(
    ("count", "room_m", "shape"),
    [
        (3, (6, 4), "line"),
        (3, (6, 4), "wedge"),
        (9, (10, 8), "circle"),
        (9, (10, 8), "grid"),
        (25, (16, 16), "wedge"),
        (25, (16, 16), "grid"),
    ],
)
def test_a_shape_is_formed_without_near_misses(count: int, room_m: tuple[float, float], shape: str) -> None:
    robots = scattered(count, room_m, seed=count)
    with watched(robots, room_m, seed=count) as (simulation, recorder):
        report, _ = run(simulation, "formation", shape=shape, spacing_m=0.8)
        rule = Formation.model_validate({"shape": shape, "count": count, "spacing_m": 0.8})
        off_m = worst_m(simulation, rule)
    assert (report.error, report.outcome) == (None, "done")
    assert off_m <= 0.05
    assert least_gap_m(recorder.paths_since(0), robots) >= MARGIN_M


def test_without_assignment_and_phases_there_are_near_misses() -> None:
    """The same nine robots and places as above; each robot goes to the place of its number, all at once."""
    robots = scattered(9, (10, 8), seed=9)
    places = formation_poses(Formation(shape="grid", count=9, spacing_m=0.8))
    with watched(robots, (10, 8), seed=9) as (simulation, recorder):
        legs = [
            leg_commands(simulation.pose(name), (place.x_m, place.y_m), 20.0)
            for name, place in zip(robots, places, strict=True)
        ]
        for part in (0, 1):
            commands = {name: leg[part] for name, leg in zip(robots, legs, strict=True)}
            gather([simulation[name]["Base"].send_cmd(cmd, timeout_s=60) for name, cmd in commands.items()]).get()
    assert least_gap_m(recorder.paths_since(0), robots) < MARGIN_M


def test_a_shape_that_is_too_narrow_is_refused_before_a_robot_moves() -> None:
    with Simulation(fleet_file("formation")) as simulation:
        before = {name: simulation.pose(name) for name in simulation.fleet}
        report, _ = run(simulation, "formation", spacing_m=0.5)
        assert {name: simulation.pose(name) for name in simulation.fleet} == before
    assert report.outcome == "failed"
    assert "two places are 0.50 m apart; the margin needs 0.60 m between centres" in message(report)


def test_a_robot_that_cannot_reach_its_place_fails_the_formation() -> None:
    with Simulation(fleet_file("formation")) as simulation:
        simulation.inject("roomba-1", stuck_left=True, stuck_right=True)
        report, _ = run(simulation, "formation")
    assert report.outcome == "failed"
    assert report.robots["roomba-1"].outcome == "failed"
    assert "still true after 100 rounds" in message(report)


def test_formation_in_python() -> None:
    with Simulation(fleet_file("formation")) as simulation:
        assert formation_py.form(simulation.fleet, "wedge", 1.0) <= 0.03
        assert worst_m(simulation, Formation(shape="wedge", count=9, spacing_m=1.0)) <= 0.03


# Patrol.


def test_the_patrol_reports_moved_things_and_ignores_noise(tmp_path: Path) -> None:
    with Simulation(fleet_file("patrol")) as simulation:
        for guard in ("evbot3-1", "evbot3-2"):
            simulation[guard]["Camera"].set_config("noise", 5.0).get()
        report, said = run(simulation, "patrol-visit", tmp_path)
    assert (report.error, report.outcome) == (None, "done")
    assert sorted(path.name for path in (tmp_path / "evbot3-2").glob("changed.*")) == [
        "changed.1.2.png",
        "changed.1.3.png",
    ]
    assert not list((tmp_path / "evbot3-1").glob("changed.*")), "nobody moved the crate that it looks at"
    assert said == [
        "evbot3-2: place 2 has changed: see changed.1.2.png",
        "evbot3-2: place 3 has changed: see changed.1.3.png",
        "evbot3-1: 0 changes in 3 laps",
        "evbot3-2: 2 changes in 3 laps",
    ]


def test_the_patrol_in_python_reports_moved_things() -> None:
    with Simulation(fleet_file("patrol")) as simulation:

        def visit(visitor: RobotHandle) -> None:
            simulation.fleet.clock.sleep(24.0)
            for command in ("f2.4", "b2.4"):
                visitor["Base"].send_cmd(command).get()

        with simulation.fleet.tasks() as tasks:
            tasks.start(visit, simulation["roomba-1"])
            changes = patrol_py.patrol(simulation.fleet)
        places = {name: simulation.pose(name) for name in simulation.fleet}
        simulation.advance(5)
        assert {name: simulation.pose(name) for name in simulation.fleet} == places, "all stand"
    assert changes == [("evbot3-2", 1, 2), ("evbot3-2", 1, 3)]


# Search.


def hall_with_a_beacon(x_m: float, y_m: float, reach_m: float) -> dict[str, Any]:
    beacon = {"name": "lost", "x_m": x_m, "y_m": y_m, "reach_m": reach_m}
    return {"version": 1, "name": "hall", "size_m": [10, 8], "beacons": [beacon]}


@pytest.mark.parametrize(
    ("x_m", "y_m", "finder"), [(2.9, 1.9, "roomba-2"), (0.5, -2.4, "evbot3-1"), (-1.0, 0.7, "roomba-1")]
)
def test_the_first_to_hear_the_beacon_stops_the_rest(x_m: float, y_m: float, finder: str) -> None:
    with Simulation(fleet_file("search"), hall_with_a_beacon(x_m, y_m, 0.8)) as simulation:
        report, said = run(simulation, "search")
        places = {name: simulation.pose(name) for name in simulation.fleet}
        simulation.advance(5)
        assert {name: simulation.pose(name) for name in simulation.fleet} == places, "all stand"
    assert (report.error, report.outcome) == (None, "done")
    assert said == [f"{finder} found beacon 0 at x {x_m:g} m, y {y_m:g} m"]
    assert math.dist(places[finder][:2], (x_m, y_m)) <= 0.8
    stopped = {step.robot for step in report.steps if step.outcome == "stopped" and step.kind == "wait_until"}
    assert stopped == set(places) - {finder}


def test_a_beacon_out_of_range_is_not_found() -> None:
    with Simulation(fleet_file("search"), hall_with_a_beacon(4.9, 3.9, 0.2)) as simulation:
        report, said = run(simulation, "search")
    assert report.outcome == "failed"
    assert message(report).startswith("nobody found beacon 0: ")
    assert said == []


def test_the_search_ends_at_its_limit() -> None:
    with Simulation(fleet_file("search")) as simulation:
        report, _ = run(simulation, "search", limit_s=10.0)
        assert simulation.now_s == pytest.approx(10.0, abs=0.5)
    assert report.outcome == "failed"
    assert "did not become true within 10 s" in message(report)


def test_search_in_python() -> None:
    with Simulation(fleet_file("search")) as simulation:
        finding = search_py.search(simulation.fleet)
        assert [simulation[name]["Base"].get_status().get() for name in simulation.fleet] == [0] * 4
    assert finding is not None
    assert finding[0] == "roomba-2"
    assert math.dist(finding[1:], (2.9, 1.9)) < 0.01
    with Simulation(fleet_file("search"), hall_with_a_beacon(4.9, 3.9, 0.2)) as simulation:
        assert search_py.search(simulation.fleet) is None


# Relay.


def test_each_runner_continues_where_the_last_one_stopped() -> None:
    with Simulation(fleet_file("relay")) as simulation:
        homes = {name: simulation.pose(name) for name in simulation.fleet}
        with PoseRecorder(simulation.fleet, homes) as recorder:
            report, said = run(simulation, "relay")
        left = {name: float(simulation[name]["Battery"].get_value().get().value) for name in homes}
        assert all(simulation.distance_m(name, homes[name][:2]) < 0.06 for name in homes)
    assert (report.error, report.outcome) == (None, "done")
    assert [line.split(" are done")[0] for line in said] == [
        "roomba-1: marks 0 to 12",
        "roomba-2: marks 13 to 21",
        "roomba-3: marks 22 to 23",
    ]
    assert 0.19 < left["roomba-1"] < 0.2, "it was low, and came home on what was left"
    paths = recorder.paths_since(0)
    near_13 = [sample.time_s for sample in paths["roomba-2"] if math.dist((sample.x_m, sample.y_m), mark(13)) < 0.06]
    end_s = max(step.end_s for step in report.steps if step.robot == "roomba-1" and step.command != "s")
    assert min(near_13) > end_s, "the second sets out when the first is home"
    assert not any(math.dist((s.x_m, s.y_m), mark(13)) < 0.3 for s in paths["roomba-1"] if s.time_s > 60)


def mark(number: int) -> tuple[float, float]:
    angle_rad = math.radians(30 * number - 90)
    return 2.5 * math.cos(angle_rad), 0.4 + 2.5 * math.sin(angle_rad)


def test_when_every_battery_is_low_the_relay_reports_its_progress() -> None:
    with Simulation(fleet_file("relay")) as simulation:
        report, _ = run(simulation, "relay", laps=9)
    assert report.outcome == "failed"
    done = sum(step.command is not None and step.command.startswith("f") for step in report.steps)
    assert done > 20
    assert "the battery of every robot is low, after " in message(report)
    assert " of 108 marks" in message(report)


def test_with_empty_batteries_no_robot_moves_and_the_relay_fails() -> None:
    robots = {f"r{n}": {"model": "roomba", "charge": 0.0, "start": (2.0 * n, -3.4, 90)} for n in (-1, 0, 1)}
    robots = {name.replace("-", "m"): settings for name, settings in robots.items()}
    with Simulation(robots, {"version": 1, "name": "hall", "size_m": [10, 8]}) as simulation:
        report, said = run(simulation, "relay")
    assert report.outcome == "failed"
    assert message(report).startswith("the battery of every robot is low, after 0 of 24 marks")
    assert said == []


def test_a_runner_whose_battery_dies_on_the_way_ends_the_relay() -> None:
    faults = [{"at_s": 20.0, "battery_empty": True}]
    robots = {"r1": {"model": "roomba", "start": (-2, -3.4, 90), "faults": faults}}
    robots["r2"] = {"model": "roomba", "start": (2, -3.4, 90)}
    with Simulation(robots, {"version": 1, "name": "hall", "size_m": [10, 8]}) as simulation:
        report, _ = run(simulation, "relay")
    assert {name: robot.outcome for name, robot in report.robots.items()} == {"r1": "failed", "r2": "aborted"}
    assert "battery is empty: robot 'r1' has stopped" in message(report)


def test_relay_in_python() -> None:
    with Simulation(fleet_file("relay")) as simulation:
        assert relay_py.relay(simulation.fleet, 2) == {"roomba-1": 13, "roomba-2": 9, "roomba-3": 2}
