"""The steps `go_to` and `follow`: robots end at their places, and what is no place is refused."""

from __future__ import annotations

import math

import pytest

from eal_actors.kernel.errors import ConfigError
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
        'go_to: {x_m: "${home[0] + 0.3}", y_m: "${home[1]}", yaw_deg: 90}',
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
