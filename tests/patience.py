"""Fleets and scenarios that run fast, with deadlines so long that a machine that stumbles misses none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from eal_actors import Fleet
from eal_actors.kernel.lock_step import Rate
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import Scenario, load_scenario

LONG_S = 10_000.0


def patient_fleet(path: Path, rate: Rate, seed: int | None = None) -> Fleet:
    """Return a fleet, faster than its file says."""
    config = EALConfigManager.load(path).fleet
    robots = {name: replace(robot, timeout_s=LONG_S) for name, robot in config.robots.items()}
    return Fleet(replace(config, rate=rate, seed=config.seed if seed is None else seed, robots=robots))


def patient_scenario(path: Path) -> Scenario:
    """Return a scenario without hurry."""
    scenario = load_scenario(path)
    return replace(scenario, file=scenario.file.model_copy(update={"timeout_s": LONG_S}))
