"""Simulated robots that are calibrated by squares: how much smaller their errors become, by the length of the sides.

The long form (`make test-slow`) uses 20 fixed seeds and 20 that the date chooses; `EAL_SEED` repeats those of a day.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from datetime import UTC, datetime
from statistics import median

import numpy as np
import pytest

from eal_actors.lab.calibration.drive import GroundTruth, calibrate_base, drive_squares, wheelbase_of
from eal_actors.lab.calibration.fit import fit_squares
from eal_actors.testing import Simulation

SIDES_M = (1.0, 2.0, 4.0)
SQUARES = 5
FACTORS = {"roomba": 10.0, "evbot2": 15.0, "evbot3": 5.0}
FLOOR = {"version": 1, "name": "floor", "size_m": (40, 40), "physics": {"rate_hz": 10}}  # wheel errors know no tick


def gain(model: str, side_m: float, seed: int) -> float:
    """Return by what the error is divided, both measured over squares of their own."""
    robots = {"rob": {"model": model, "calibrated": False, "start": (0.0, 0.0)}}
    with Simulation(robots, world=FLOOR, seed=seed) as simulation:
        robot = simulation["rob"]
        truth, wheelbase_m = GroundTruth(robot), wheelbase_of(robot)
        assert wheelbase_m is not None
        before = drive_squares(robot, truth, side_m, SQUARES)
        calibrate_base(robot, fit_squares(before, side_m, wheelbase_m).calibration)
        return before.error_m / drive_squares(robot, truth, side_m, SQUARES).error_m


def check(model: str, side_m: float, seeds: Iterable[int]) -> None:
    gains = {seed: gain(model, side_m, seed) for seed in seeds}
    table = f"{model}, sides of {side_m:g} m: median {median(gains.values()):.1f}, least {min(gains.values()):.1f}"
    print(table)  # noqa: T201  # shown with -s, and beside a failure
    assert median(gains.values()) >= FACTORS[model], f"{table}; by seed: {gains}"
    assert min(gains.values()) > 1, f"{table}; by seed: {gains}"


@pytest.mark.parametrize(
    "model", [pytest.param("roomba", marks=pytest.mark.slow), pytest.param("evbot2", marks=pytest.mark.slow), "evbot3"]
)
def test_a_calibration_makes_errors_smaller(model: str) -> None:
    check(model, 2.0, range(3))


@pytest.mark.slow
@pytest.mark.parametrize("side_m", SIDES_M)
@pytest.mark.parametrize("model", FACTORS)
def test_a_calibration_makes_errors_smaller_whatever_the_seed(model: str, side_m: float) -> None:
    check(model, side_m, range(20))


@pytest.mark.slow
@pytest.mark.parametrize("side_m", SIDES_M)
@pytest.mark.parametrize("model", FACTORS)
def test_a_calibration_makes_errors_smaller_with_seeds_of_the_day(model: str, side_m: float) -> None:
    day = os.environ.get("EAL_SEED", f"{datetime.now(UTC):%Y%m%d}")
    print(f"EAL_SEED={day}")  # noqa: T201
    check(model, side_m, np.random.default_rng(int(day)).choice(1_000_000, 20, replace=False).tolist())
