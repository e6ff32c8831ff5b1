"""The shipped scenarios on the shipped simulated fleet."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.bundled import bundled_path
from eal_actors.scenario import Report, run_scenario
from tests.patience import patient_fleet, patient_scenario

ROBOTS = ("evbot2-1", "evbot3-1", "roomba-1")
DANCE = ("r45", "l90", "r90", "l10", "r10", "l10", "r360")


@pytest.fixture
def sim() -> Iterator[Fleet]:
    with patient_fleet(bundled_path("fleets/sim.yaml"), rate=50) as fleet:
        yield fleet


def run(fleet: Fleet, name: str, directory: Path) -> Report:
    report = run_scenario(patient_scenario(bundled_path(f"scenarios/{name}.yaml")), fleet, directory=directory / name)

    assert report.error is None
    assert report.outcome == "done"
    assert tuple(report.robots) == ROBOTS
    return report


def poses(fleet: Fleet) -> dict[str, tuple[float, float, float]]:
    return {name: tuple(robot["TruePose"].get_value().get().value) for name, robot in fleet.items()}


def commands(report: Report, robot: str) -> list[str | None]:
    return [step.command for step in report.steps if step.robot == robot and step.kind == "send_cmd"]


def test_square_ends_near_its_start(sim: Fleet, tmp_path: Path) -> None:
    before = poses(sim)
    report = run(sim, "square", tmp_path)
    after = poses(sim)

    for robot in ROBOTS:
        assert commands(report, robot) == [*["g", "r"] * 4, "s", *["l", "b"] * 4, "s", "s"]
        assert math.dist(before[robot][:2], after[robot][:2]) < 0.25, "half a side, for the wheels are not perfect"


def test_dance_is_synchronized_step_by_step(sim: Fleet, tmp_path: Path) -> None:
    report = run(sim, "dance", tmp_path)

    before_s = 0.0
    for number, move in enumerate(DANCE):
        steps = report.steps[number * 3 : number * 3 + 3]
        assert {(step.robot, step.command) for step in steps} == {(robot, move) for robot in ROBOTS}
        assert min(step.start_s for step in steps) >= before_s, "nobody begins before the last has ended"
        before_s = max(step.end_s for step in steps)
    assert len(report.starts) == len(DANCE)
    assert max(step.start_s for step in steps) < min(step.end_s for step in steps), "the long last turn is a common one"
    for robot in ROBOTS:
        assert commands(report, robot) == [*DANCE, "s"]


@pytest.mark.slow
def test_panorama_takes_eight_pictures(sim: Fleet, tmp_path: Path) -> None:
    from matplotlib.image import imread

    run(sim, "panorama", tmp_path)

    for robot in ROBOTS:
        names = sorted(path.name for path in (tmp_path / "panorama" / robot).glob("frame.*.png"))
        assert names == [f"frame.{number}.png" for number in range(8)]
        assert all((tmp_path / "panorama" / robot / name).with_suffix(".json").is_file() for name in names)
        assert imread(tmp_path / "panorama" / robot / "panorama.png").shape[1] == 3482
        pictures = [imread(tmp_path / "panorama" / robot / name) for name in names]
        assert all(picture.shape[:2] == (480, 640) for picture in pictures)
        assert not any(np.array_equal(one, next_one) for one, next_one in itertools.pairwise(pictures))
