"""The square test: each make errs by as much, and spreads as wide, as its parameters predict.

The prediction is the kinematic model alone: each leg of a square is an arc whose length and angle follow from the
wheels' factors; the scatter of the wheels and the noise of turns spread it. See Borenstein and Feng, "UMBmark".
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from plugins.sim.models import MAKES, Make, MakeName
from plugins.sim.motion import Move, moved
from plugins.sim.world import SimWorld
from tests.manual_clock import ManualClock
from tests.unit.plugins.sim.rig import arena

SEEDS = 20
SIDE_M = 1.0
PIECES = 10
TICK_S = 0.02
ROOM = arena(20.0, 20.0)

Array = NDArray[np.float64]


def legs(make: Make, direction: float) -> list[Move]:
    """Return the moves of a square: to the left where the direction is 1, to the right where it is -1."""
    turn_rad, rate_rad_s = direction * math.pi / 2, math.radians(make.turn_rate_deg_s)
    moves = []
    for _ in range(4):
        moves.append(Move.straight(make, SIDE_M, make.speed_m_s, TICK_S))
        moves.append(Move.turn(make, turn_rad, rate_rad_s, TICK_S))
    return moves


def measured(make: Make, direction: float) -> Array:
    """Return the errors of the end pose over all seeds, shape (SEEDS, 3)."""
    ends = []
    for seed in range(SEEDS):
        clock = ManualClock()
        world = SimWorld(clock, seed, ROOM)
        robot = world.join("r1", make, noise=True, start=(0.0, 0.0, 0.0))
        for leg in legs(make, direction):
            with world.lock:
                world.catch_up()
                world.start(robot, leg)
            clock.advance(leg.remaining_s)
        with world.lock:
            world.catch_up()
            ends.append((*robot.pose[:2], robot.pose[2] - direction * 2 * math.pi))
    return np.array(ends)


def pieces(make: Make, direction: float) -> tuple[Array, Array]:
    """Return what each piece of a square commands and by how much it errs, shapes (8 * PIECES, 2) and (.., 3).

    A piece is a part of a leg: the random errors of its parts are independent. Columns: left m, right m, and for the
    errors the angle in rad, which belongs to a whole turn and stands at its last piece.
    """
    commands, sigmas = [], []
    for leg in legs(make, direction):
        left_m = right_m = 0.0
        while not leg.is_over:
            left_step_m, right_step_m = leg.step()
            left_m, right_m = left_m + left_step_m, right_m + right_step_m
        wheels_m = np.array([left_m, right_m]) / PIECES
        scatter_m = make.errors.scatter_m * np.sqrt(np.abs(wheels_m))
        for piece in range(PIECES):
            is_turned = leg.noise_share != 0 and piece == PIECES - 1
            commands.append(wheels_m)
            sigmas.append((*scatter_m, make.turn_noise_rad if is_turned else 0.0))
    return np.array(commands), np.array(sigmas)


def end_of(make: Make, direction: float, commands: Array, errors: Array) -> Array:
    """Return the error of the end pose where each piece errs by (left m, right m, angle rad)."""
    pose = (0.0, 0.0, 0.0)
    track_m = make.track_m * make.errors.track_factor
    travels = commands * (make.errors.k_left, make.errors.k_right) + errors[:, :2]
    for (left_m, right_m), angle_error_rad in zip(travels.tolist(), errors[:, 2].tolist(), strict=True):
        pose = moved(pose, (left_m + right_m) / 2, (right_m - left_m) / track_m + angle_error_rad)
    return np.array(pose) - (0.0, 0.0, direction * 2 * math.pi)


def predicted(make: Make, direction: float) -> tuple[Array, Array]:
    """Return the mean and the covariance of the error of the end pose."""
    commands, sigmas = pieces(make, direction)
    still = np.zeros_like(sigmas)
    mean = end_of(make, direction, commands, still)
    covariance = np.zeros((3, 3))
    for place in zip(*np.nonzero(sigmas), strict=True):
        errors = still.copy()
        errors[place] = sigmas[place]
        change = (end_of(make, direction, commands, errors) - end_of(make, direction, commands, -errors)) / 2
        covariance += np.outer(change, change)
    return mean, covariance


@pytest.mark.slow
@pytest.mark.parametrize("direction", [1.0, -1.0], ids=["left", "right"])
@pytest.mark.parametrize("calibrated", [True, False], ids=["calibrated", "raw"])
@pytest.mark.parametrize("name", MAKES)
def test_squares_err_as_the_parameters_predict(name: MakeName, calibrated: bool, direction: float) -> None:
    make = MAKES[name] if calibrated else MAKES[name].uncalibrated()
    ends = measured(make, direction)
    mean, covariance = predicted(make, direction)
    deviations = np.sqrt(np.diag(covariance))
    assert np.all(np.abs(ends.mean(axis=0) - mean) < 4 * deviations / math.sqrt(SEEDS))
    ratios = ends.var(axis=0, ddof=1) / np.diag(covariance)
    assert np.all((ratios > 4.9 / 19) & (ratios < 48.0 / 19))  # chi square, 19 degrees of freedom, 0.05 % each side
    assert math.hypot(*mean[:2]) > 0.003


def test_the_raw_errors_are_those_of_the_square_test() -> None:
    for make, e_b, e_d in zip(MAKES.values(), (1.2, 0.985, 1.012), (1.012, 0.996, 1.004), strict=True):
        raw = make.uncalibrated().errors
        assert raw.track_factor == e_b
        assert raw.k_right / raw.k_left == pytest.approx(e_d)
        assert raw.k_right + raw.k_left == pytest.approx(2)
