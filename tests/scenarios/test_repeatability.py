"""The same fleet, scenario and seed give the same paths bit for bit, at any rate of the clock."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import load_scenario, run_scenario

ROOT = Path(__file__).parents[2]


def poses_after(scenario: str, rate: float, seed: int) -> dict[str, list[str]]:
    """Run a scenario; return where each robot ended up, to the last bit."""
    config = replace(EALConfigManager.load(ROOT / "fleets/sim.yaml").fleet, rate=rate, seed=seed)
    with Fleet(config) as fleet:
        report = run_scenario(load_scenario(ROOT / "scenarios" / scenario), fleet)
        assert report.outcome == "done", report.error
        return {
            name: [float(number).hex() for number in robot["Pose"].get_value().get().value]
            for name, robot in fleet.items()
        }


@pytest.mark.parametrize("scenario", ["dance.yaml", "square.yaml"])
def test_the_rate_of_the_clock_does_not_change_the_paths(scenario: str) -> None:
    slow = poses_after(scenario, rate=20, seed=7)
    assert slow == poses_after(scenario, rate=61, seed=7)
    assert slow != poses_after(scenario, rate=61, seed=8)
