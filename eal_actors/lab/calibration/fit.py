"""The exact fit of the square test: the two numbers with which the kinematics explain the measured ends best."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeAlias

from eal_actors.device.differential_base import NOMINAL, WheelCalibration
from eal_actors.kernel.errors import ArgumentError
from eal_actors.lab.calibration.square import WAYS, square_end
from eal_actors.lab.calibration.umbmark import SquareEnds, calibration_of, require_sizes

Vector: TypeAlias = list[float]
Residuals: TypeAlias = Callable[[Vector], Vector]

MOST_STEPS: Final = 30
_SETTLED: Final = 1e-10
"""A step of Gauss-Newton that changes both numbers by less is the last."""
_NUDGE: Final = 1e-6
"""Of a number, for its derivative by central differences."""
_MOST_HALVINGS: Final = 20
_DOUBT: Final = 3.0
"""In standard deviations: chance leaves no more over than that."""
_FINE_M: Final = 0.002
"""Nor does measuring and counting."""
_CHANCE: Final = 0.1
"""Of the side: what chance may leave over of single squares, which tell nothing of it."""
_ROUNDING: Final = 1e-12
_SINGULAR: Final = 1e-9
"""Of what it would be at best; a determinant below tells that both unknowns do the same."""


@dataclass(frozen=True, slots=True)
class Fit:
    """What was fitted.

    Attributes:
        calibration: E_b and E_d.
        left_over_m: how far the farther one of the two centres of gravity is from where the kinematics put it: what a
            base is still off by that is calibrated so.
        steps: of Gauss-Newton.
        is_doubtful: more is left over than chance explains: something beside the wheels had a hand in it.
    """

    calibration: WheelCalibration
    left_over_m: float
    steps: int
    is_doubtful: bool


def fit_squares(ends: SquareEnds, side_m: float, wheelbase_m: float, applied: WheelCalibration = NOMINAL) -> Fit:
    """Fit the kinematics to the ends of squares, by Gauss-Newton from what was applied: 4 residuals, 2 unknowns.

    Args:
        ends: where they ended.
        side_m: length of a side.
        wheelbase_m: the nominal distance of the wheels.
        applied: the calibration that the base knew while it drove; the result takes its place.

    Raises:
        ArgumentError: the fit does not settle, or on what no base has, or explains nothing, or a length is none.
    """
    require_sizes(side_m, wheelbase_m)
    measured = [number for way in WAYS for number in ends.centre(way)]

    def residuals(unknowns: Vector) -> Vector:
        truth = calibration_of(*unknowns)
        places = (square_end(way, side_m, wheelbase_m, truth, applied) for way in WAYS)
        return [place - seen for place, seen in zip((n for end in places for n in end[:2]), measured, strict=True)]

    unknowns = [applied.track_factor, applied.wheel_ratio]
    left_over = residuals(unknowns)
    for step in range(1, MOST_STEPS + 1):
        change = _gauss_newton(residuals, unknowns, left_over)
        unknowns, left_over = _shortened(residuals, unknowns, change, left_over)
        if max(map(abs, change)) < _SETTLED:
            return _fit(ends, side_m, unknowns, left_over, step)
    raise ArgumentError(
        f"the fit of E_b and E_d does not settle in {MOST_STEPS} steps; it came to {unknowns[0]:.4g} and "
        f"{unknowns[1]:.4g} with {_worst_m(left_over) * 1000:.0f} mm left over: are x, y and the side right?"
    )


def _fit(ends: SquareEnds, side_m: float, unknowns: Vector, left_over: Vector, steps: int) -> Fit:
    """Judge what is left over; raises ArgumentError if it is nearly all."""
    left_over_m, scatter_m = _worst_m(left_over), ends.scatter_m
    if left_over_m > side_m / 2:
        raise ArgumentError(
            f"no E_b and E_d explain where the squares ended: {left_over_m:.2f} m of {ends.error_m:.2f} m are left "
            "over. Was the way blocked, or x, y or the side measured otherwise?"
        )
    chance_m = side_m * _CHANCE if scatter_m is None else max(_DOUBT * scatter_m, _FINE_M)
    return Fit(calibration_of(*unknowns), left_over_m, steps, is_doubtful=left_over_m > chance_m)


def _gauss_newton(residuals: Residuals, unknowns: Vector, left_over: Vector) -> Vector:
    """Return the change of the unknowns that would end it if the model were straight.

    Raises:
        ArgumentError: the unknowns cannot be told apart.
    """
    slopes = [_slope(residuals, unknowns, index) for index in range(2)]
    (a, b), (_, d) = [[_dot(one, other) for other in slopes] for one in slopes]
    e, f = (-_dot(slope, left_over) for slope in slopes)
    determinant = a * d - b * b
    if determinant <= _SINGULAR * a * d:
        raise ArgumentError("squares of these lengths cannot tell E_b and E_d apart: are the side and the base right?")
    return [(e * d - b * f) / determinant, (a * f - b * e) / determinant]


def _slope(residuals: Residuals, unknowns: Vector, index: int) -> Vector:
    """Return how the residuals change with one of the unknowns."""
    more, less = list(unknowns), list(unknowns)
    more[index] += _NUDGE
    less[index] -= _NUDGE
    return [(high - low) / (2 * _NUDGE) for high, low in zip(residuals(more), residuals(less), strict=True)]


def _shortened(residuals: Residuals, unknowns: Vector, change: Vector, left_over: Vector) -> tuple[Vector, Vector]:
    """Take the change, or as much of it as makes the residuals no larger; return unknowns and residuals.

    Raises:
        ArgumentError: no part of it does.
    """
    for halvings in range(_MOST_HALVINGS):
        nearer = [unknown + part / 2**halvings for unknown, part in zip(unknowns, change, strict=True)]
        try:
            smaller = residuals(nearer)
        except ArgumentError:  # beyond what a base can have
            if halvings == _MOST_HALVINGS - 1:
                raise
            continue
        if _dot(smaller, smaller) <= _dot(left_over, left_over) * (1 + _ROUNDING) + _ROUNDING**2:
            return nearer, smaller
    return unknowns, left_over


def _worst_m(left_over: Vector) -> float:
    return max(math.hypot(*left_over[:2]), math.hypot(*left_over[2:]))


def _dot(one: Vector, other: Vector) -> float:
    return sum(a * b for a, b in zip(one, other, strict=True))
