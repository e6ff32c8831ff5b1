"""The dance is as fast as its slowest robot."""

from __future__ import annotations

from dataclasses import replace

import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.bundled import bundled_path
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import Report, run_scenario
from tests.patience import LONG_S

MOVES = 7


def dance(fleet: str) -> Report:
    """Dance in lock step, and return the report."""
    config = EALConfigManager.load(bundled_path(f"fleets/{fleet}.yaml")).fleet
    robots = {name: replace(robot, timeout_s=LONG_S) for name, robot in config.robots.items()}
    with Fleet(replace(config, rate="max", robots=robots)) as opened:
        return run_scenario(bundled_path("scenarios/dance.yaml"), opened)


def over_ideal(report: Report) -> float:
    """Return by what fraction the dance took longer than the slowest robot's motions, one after the other."""
    moves = [record for record in report.steps if record.step.startswith("steps")]
    rounds = zip(*([move for move in moves if move.robot == robot] for robot in report.robots), strict=True)
    ideal_s = sum(max(move.end_s for move in moved) - min(move.start_s for move in moved) for moved in rounds)
    return float(max(move.end_s for move in moves) / ideal_s - 1.0)


@pytest.mark.parametrize(
    ("fleet", "robots", "most"), [("sim", 3, 0.03), pytest.param("swarm", 100, 0.05, marks=pytest.mark.slow)]
)
def test_a_dance_takes_little_longer_than_its_slowest_dancer(fleet: str, robots: int, most: float) -> None:
    report = dance(fleet)

    assert (report.outcome, len(report.robots), len(report.starts)) == ("done", robots, MOVES)
    assert 0.0 <= over_ideal(report) <= most
    skews = [start.skew_s for start in report.starts]
    assert all(skew_s is not None and skew_s < 1e-6 for skew_s in skews), "in lock step they begin at the same instant"
