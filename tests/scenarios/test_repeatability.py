"""The same fleet, scenario and seed give the same paths bit for bit, at any rate of the clock."""

from __future__ import annotations

from pathlib import Path

import pytest

from eal_actors.scenario import run_scenario
from tests.patience import patient_fleet, patient_scenario

ROOT = Path(__file__).parents[2]


def poses_after(scenario: str, rate: float, seed: int) -> dict[str, list[str]]:
    """Run a scenario; return each robot's last pose, to the last bit."""
    with patient_fleet(ROOT / "fleets/sim.yaml", rate, seed) as fleet:
        report = run_scenario(patient_scenario(ROOT / "scenarios" / scenario), fleet)
        assert report.outcome == "done", report.error
        return {
            name: [float(number).hex() for number in robot["TruePose"].get_value().get().value]
            for name, robot in fleet.items()
        }


@pytest.mark.parametrize("scenario", ["dance.yaml", "square.yaml"])
def test_the_rate_of_the_clock_does_not_change_the_paths(scenario: str) -> None:
    slow = poses_after(scenario, rate=20, seed=7)
    assert slow == poses_after(scenario, rate=61, seed=7)
    assert slow != poses_after(scenario, rate=61, seed=8)
