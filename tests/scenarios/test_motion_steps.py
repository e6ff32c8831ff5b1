"""The steps `go_to` and `follow`: robots end at their places, and what is no place is refused."""

from __future__ import annotations

import math

import pytest

from eal_actors.kernel.errors import ArgumentError, ConfigError, PlaceNotFoundError
from eal_actors.testing import Simulation

HEAD = "version: 1\nname: places\nroles: {all: {}}\nsteps:\n  - on: all\n    do:\n"


def scenario(*steps: str) -> str:
    return HEAD + "".join(f"      - {step}\n" for step in steps)


@pytest.fixture
def simulation() -> Simulation:
    return Simulation(
        {"a": {"model": "roomba", "start": (0, 0, 0)}, "b": {"model": "evbot2", "start": (0, -1.2, 0)}}, seed=3
    )


def test_robots_drive_to_places_and_along_paths(simulation: Simulation) -> None:
    text = scenario(
        "let: {home: value('Pose')}",
        'go_to: {x_m: "${home[0] + 0.3}", y_m: "${home[1]}", yaw_deg: "${9 * 90}"}',
        'follow: {path_m: [["${home[0] + 0.3}", "${home[1] + 0.3}"], ["${home[0]}", "${home[1] + 0.3}"]]}',
        'go_to: {resource: Base, x_m: "${home[0]}", y_m: "${home[1] - 0.2}"}\n        together: true',
    )
    with simulation:
        report = simulation.run(text)
        assert report.outcome == "done", report
        for name, y_m in (("a", -0.2), ("b", -1.4)):
            estimate = simulation[name].pose.get().get()
            assert math.hypot(estimate.x_m, estimate.y_m - y_m) < 0.01
        labels = [record.label for record in report.steps if record.kind in ("go_to", "follow")]
    assert "go_to Base 0.300 0.000 1.571" in labels


@pytest.mark.parametrize(
    ("step", "part"),
    [
        ("go_to: {x_m: 1}", "y_m"),
        ("go_to: {x_m: 1, y_m: near}", "y_m must be a finite number, not 'near'"),
        ("go_to: {x_m: 1, y_m: true}", "y_m must be a finite number, not true"),
        ("go_to: {x_m: 1, y_m: 2, yaw_rad: 1}", "unknown key 'yaw_rad'"),
        ("go_to: {resource: Bse, x_m: 1, y_m: 2}", "did you mean 'Base'"),
        ("go_to: {resource: Bump, x_m: 1, y_m: 2}", "does not support send_cmd"),
        ("follow: {path_m: 3}", "must be a list of waypoints [x, y], not 3"),
        ("follow: {path_m: [1, 2]}", "a waypoint must be [x, y], not 1"),
        ("follow: {path_m: [[1, 2, 3]]}", "a waypoint must be [x, y], not (1, 2, 3)"),
        ("follow: {path_m: [[1, there]]}", "a waypoint must be a finite number, not 'there'"),
    ],
)
def test_what_is_no_place_is_refused_before_anything_moves(simulation: Simulation, step: str, part: str) -> None:
    with simulation, pytest.raises(ConfigError) as caught:
        simulation.run(scenario(step))
    assert part in str(caught.value)


HALL = {
    "version": 1,
    "name": "hall",
    "size_m": [6, 4],
    "obstacles": [{"kind": "box", "x_m": 0.0, "y_m": 0.0, "size_m": [0.3, 0.6], "height_m": 1.0}],
    "places": {
        "east": {"x_m": 1.0, "y_m": 0.0, "yaw_deg": 90},
        "west": {"x_m": -1.0, "y_m": 0.0},
        "north": {"x_m": 0.0, "y_m": 1.2},
    },
}


@pytest.fixture
def hall() -> Simulation:
    """A pillar between two robots."""
    robots = {"a": {"model": "roomba", "start": (-1, 0, 0)}, "b": {"model": "roomba", "start": (1, 0, 180)}}
    return Simulation(robots, HALL, seed=3)


def believed(simulation: Simulation) -> dict[str, tuple[float, float]]:
    """Where the robots believe to be: they have odometry only."""
    poses = {name: simulation[name].pose.get().get() for name in simulation.fleet}
    return {name: (pose.x_m, pose.y_m) for name, pose in poses.items()}


def test_robots_swap_places_visit_others_and_form_a_line(hall: Simulation) -> None:
    text = scenario(
        "go_to: {places: [east, west]}",
        "visit: [north, [-1.0, -1.0, 45]]\n        split: true\n        do:\n          - let: {seen: place}",
        "let: {at: value('Pose')}",
    )
    text += "  - formation: {role: all, shape: \"${'line'}\", spacing_m: 1.0, at: west}\n"
    with hall:
        report = hall.run(text)
        assert report.error is None
        labels = [(step.robot, step.label) for step in report.steps]
        places = believed(hall)
    assert {("a", "go_to east"), ("b", "go_to west"), ("a", "visit north"), ("b", "visit (-1, -1, 45)")} <= set(labels)
    assert (None, "formation all line") in labels
    assert {name: robot.variables["seen"] for name, robot in report.robots.items()} == {
        "a": "north",
        "b": [-1.0, -1.0, 45.0],
    }
    assert places["a"] == pytest.approx((-1.0, 0.5), abs=0.02), "a came from the north"
    assert places["b"] == pytest.approx((-1.0, -0.5), abs=0.02)


def test_a_place_that_nobody_can_reach_fails_the_step_and_nobody_moves(hall: Simulation) -> None:
    with hall:
        report = hall.run(scenario("go_to: {places: [[0, 0], west]}"))
        assert report.error is not None
        assert (report.outcome, report.error.code) == ("failed", "argument")
        assert "(0.00, 0.00)" in report.error.message
        assert hall.pose("a")[:2] == (-1.0, 0.0)


TO_PLACES = [
    ("go_to: {place: esat}", "unknown place 'esat'; did you mean "),
    ("go_to: {place: east}", "several robots would go to one place, east; give each its own: `places`"),
    ("go_to: {places: [east]}", "1 places are too few for the 2 robots of the role"),
    ("go_to: {places: [east, east]}", "two robots would go to one place, east"),
    ("go_to: {places: [east, west]}\n        together: true", "is for x_m and y_m"),
    ("go_to: {place: [1]}", "a place must be the name of one, [x_m, y_m] or [x_m, y_m, yaw_deg], not"),
    ("visit: [east, esat]", "unknown place 'esat'"),
    ('visit: "${3}"', "places must be a list, not 3"),
    ("go_to: {places: [[0, 1], [0, 2.1]]}", "(0.00, 2.10) is outside the room of 6 x 4 m"),
    ("visit: [[0, x]]", "a number of a place must be a finite number, not 'x'"),
    (
        "visit: [east]\n        do:\n          - visit: [west]",
        "'place' is the variable of a loop around this one already",
    ),
    (
        'visit: [east, [1, -0.8]]\n        do:\n          - log: "at ${place}"',
        "${place} is of type list, which has no form",
    ),
]


@pytest.mark.parametrize(("step", "part"), TO_PLACES)
def test_places_are_checked_before_anything_moves(hall: Simulation, step: str, part: str) -> None:
    with hall, pytest.raises(ConfigError) as caught:
        hall.run(scenario(step))
    assert part in str(caught.value)


@pytest.mark.parametrize(
    ("given", "part"),
    [
        ("{role: al, shape: line, spacing_m: 1}", "unknown role 'al'; did you mean 'all'?"),
        ("{role: all, shape: lin, spacing_m: 1}", "invalid formation: shape: must be 'line', "),
        ("{role: all, shape: lin, spacing_m: 1}", "not 'lin'; did you mean 'line'?"),
        ("{role: all, shape: line, spacing_m: 0}", "invalid formation: spacing_m: must be at least 0.001, not 0.0"),
        ("{role: all, shape: line, spacing_m: 4.1}", "(0.00, 2.05) is outside the room of 6 x 4 m"),
        ("{role: all, shape: line, spacing_m: 1, at: [0, 1.6]}", "(0.00, 2.10) is outside the room of 6 x 4 m"),
        ("{role: all, shape: line, spacing_m: 1, at: esat}", "unknown place 'esat'"),
        ("{role: all, shape: line, spacing_m: 1, at: 7}", "a place must be the name of one"),
    ],
)
def test_a_formation_is_checked_before_anything_moves(hall: Simulation, given: str, part: str) -> None:
    with hall, pytest.raises(ConfigError) as caught:
        hall.run(f"{HEAD.partition('steps:')[0]}steps:\n  - formation: {given}\n")
    assert part in str(caught.value)


def test_the_same_in_python(hall: Simulation) -> None:
    with hall:
        assert [str(place) for place in hall.fleet.visit("a", ["north", "west"])] == ["north", "west"]
        assert list(hall.fleet.visit("a", "west")) == ["west"]
        hall.fleet.form(hall.fleet, "column", spacing_m=0.8, at="east").get()
        assert sorted(round(y_m, 1) for _, y_m in believed(hall).values()) == [-0.4, 0.4]
        with pytest.raises(ArgumentError, match="invalid formation: shape"):
            hall.fleet.form(["a", "b"], "heart", spacing_m=1.0)
        with pytest.raises(PlaceNotFoundError):
            hall.fleet.form(["a", "b"], "line", spacing_m=1.0, at="esat")
        with pytest.raises(ArgumentError, match="a robot is given twice: a, a"):
            hall.fleet.form(["a", "a"], "line", spacing_m=1.0)
        assert hall.fleet.form("a", "line", spacing_m=1.0, at="north").get() == {"a": 1}
