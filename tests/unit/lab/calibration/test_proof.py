"""Simulated robots that are calibrated by squares: how much smaller their errors become."""

from __future__ import annotations

from statistics import median

import pytest

from eal_actors.lab.calibration.drive import GroundTruth, calibrate_base, drive_squares, wheelbase_of
from eal_actors.lab.calibration.fit import fit_squares
from eal_actors.testing import Simulation

SIDE_M = 1.0
SQUARES = 5
FACTORS = {"roomba": 10.0, "evbot2": 15.0, "evbot3": 5.0}


def gain(model: str, seed: int) -> float:
    """Return by what the error is divided, both measured over squares of their own."""
    with Simulation({"rob": {"model": model, "calibrated": False}}, seed=seed) as simulation:
        robot = simulation["rob"]
        truth, wheelbase_m = GroundTruth(robot), wheelbase_of(robot)
        assert wheelbase_m is not None
        before = drive_squares(robot, truth, SIDE_M, SQUARES)
        calibrate_base(robot, fit_squares(before, SIDE_M, wheelbase_m).calibration)
        return before.error_m / drive_squares(robot, truth, SIDE_M, SQUARES).error_m


@pytest.mark.parametrize("model", FACTORS)
def test_a_calibration_makes_errors_smaller(model: str) -> None:
    assert median(gain(model, seed) for seed in range(5)) >= FACTORS[model]


@pytest.mark.slow
@pytest.mark.parametrize("model", FACTORS)
def test_a_calibration_makes_errors_smaller_whatever_the_seed(model: str) -> None:
    gains = [gain(model, seed) for seed in range(20)]
    assert median(gains) >= FACTORS[model], f"20 seeds: {[round(value, 1) for value in gains]}"
    assert min(gains) > 1
