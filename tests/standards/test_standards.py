"""One barrier, three standards: whichever robot fails, the other three finish the square."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from eal_actors.scenario import Report
from tests.standards.drive import drive

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

REASONS = {
    "turtle-1": "no message on /turtle/odom",
    "agv-1": "connection says CONNECTIONBROKEN",
    "rover-1": "has sent no",
    "roomba-1": "was lost",
}
SIDE_M = 0.4
CORNERS = 4


def barriers(report: Report, robot: str) -> list[tuple[float, float]]:
    """Return when a robot came to each barrier and left it."""
    return [
        (step.start_s, step.end_s)
        for step in report.steps
        if (step.robot, step.kind, step.outcome) == (robot, "barrier", "done")
    ]


@pytest.mark.parametrize("failing", REASONS)
def test_one_fails_and_three_finish(tmp_path: Path, failing: str) -> None:
    driven = drive(tmp_path, failing, SIDE_M)
    report = driven.run.summary
    assert report is not None
    assert (driven.exit_code, report.outcome, list(report.dropped)) == (0, "done", [failing])
    error = report.robots[failing].error
    assert error is not None
    assert REASONS[failing] in error.message
    assert set(report.robots) == set(driven.run.paths) == set(driven.shown) == set(REASONS)
    for robot in REASONS:
        for path in ([(one.x_m, one.y_m) for one in driven.run.paths[robot]], driven.shown[robot]):
            assert max(math.dist(driven.starts[robot], place) for place in path) > SIDE_M, robot
        if robot != failing:
            assert math.dist(driven.starts[robot], driven.ends[robot]) < 0.15, robot
    met = [barriers(report, robot) for robot in REASONS if robot != failing]
    assert 2 <= len(barriers(report, failing)) < 1 + CORNERS
    for together in zip(*met, strict=True):
        assert min(left for _, left in together) >= max(came for came, _ in together)
    assert len(met[0]) == 1 + CORNERS
