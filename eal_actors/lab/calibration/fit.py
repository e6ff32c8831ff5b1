"""Exact fit of the square test: the calibration for which the kinematics best explain the measured ends.

The closed form of Borenstein and Feng is accurate to first order only. It is good for wheels, but for tracks, whose E_b
is about 1.2, it loses more than a quarter of E_d - 1. Hence Gauss-Newton on the exact kinematics.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeAlias

from pydantic import ValidationError

from eal_actors.device.differential_base import NOMINAL, WheelCalibration
from eal_actors.kernel.errors import ArgumentError
from eal_actors.lab.calibration.square import WAYS, SquareEnds, square_end

Vector: TypeAlias = list[float]
Residuals: TypeAlias = Callable[[Vector], Vector]

MOST_STEPS: Final = 30
_CONVERGED: Final = 1e-10  # a smaller change of both unknowns ends the iteration
_NUDGE: Final = 1e-6  # change of an unknown for its derivative by central differences
_MOST_HALVINGS: Final = 20
_DOUBT: Final = 3.0  # standard deviations; chance explains no larger residual
_FINE_M: Final = 0.002  # smaller residuals are within the accuracy of measuring and counting
_CHANCE: Final = 0.1  # share of the side that chance may explain for single squares, whose scatter is unknown
_ROUNDING: Final = 1e-12
_SINGULAR: Final = 1e-9  # share of the largest possible determinant; below it, both unknowns have the same effect


@dataclass(frozen=True, slots=True)
class Fit:
    """The result of a fit.

    Attributes:
        left_over_m: largest distance of a centre of gravity from its fitted position: the error that remains with this
            calibration.
        is_doubtful: chance does not explain `left_over_m`: there is a cause other than the wheels.
    """

    calibration: WheelCalibration
    left_over_m: float
    steps: int
    is_doubtful: bool


def fit_squares(ends: SquareEnds, side_m: float, wheelbase_m: float, applied: WheelCalibration = NOMINAL) -> Fit:
    """Fit the kinematics to the ends of squares by Gauss-Newton, with 4 residuals and 2 unknowns.

    `applied` is the calibration that the base used while it drove, the start of the iteration; the result replaces it.
    Raises ArgumentError if the fit does not converge, its result is impossible for a base or explains nothing, or a
    length is not positive.
    """
    for what, length_m in (("side", side_m), ("wheelbase", wheelbase_m)):
        if not (math.isfinite(length_m) and length_m > 0):
            raise ArgumentError(f"the {what} must be over 0 m, not {length_m:g} m")
    measured = [number for way in WAYS for number in ends.centre(way)]

    def residuals(unknowns: Vector) -> Vector:
        truth = _calibration_of(*unknowns)
        places = (square_end(way, side_m, wheelbase_m, truth, applied) for way in WAYS)
        return [place - seen for place, seen in zip((n for end in places for n in end[:2]), measured, strict=True)]

    unknowns = [applied.track_factor, applied.wheel_ratio]
    left_over = residuals(unknowns)
    for step in range(1, MOST_STEPS + 1):
        change = _gauss_newton(residuals, unknowns, left_over)
        unknowns, left_over = _line_search(residuals, unknowns, change, left_over)
        if max(map(abs, change)) < _CONVERGED:
            return _assess(ends, side_m, unknowns, left_over, step)
    raise ArgumentError(
        f"the fit of E_b and E_d does not converge in {MOST_STEPS} steps; it reached {unknowns[0]:.4g} and "
        f"{unknowns[1]:.4g} with an error of {_worst_m(left_over) * 1000:.0f} mm: are x, y and the side right?"
    )


def _calibration_of(track_factor: float, wheel_ratio: float) -> WheelCalibration:
    """Return a calibration; raise ArgumentError if no base can have it."""
    try:
        return WheelCalibration(track_factor=track_factor, wheel_ratio=wheel_ratio)
    except ValidationError:
        raise ArgumentError(
            f"the squares give E_b {track_factor:.4g} and E_d {wheel_ratio:.4g}, which is impossible: was the robot "
            "blocked, a square incomplete, or x, y or the side measured differently?"
        ) from None


def _assess(ends: SquareEnds, side_m: float, unknowns: Vector, left_over: Vector, steps: int) -> Fit:
    """Return the fit with its assessment; raise ArgumentError if it explains nearly nothing."""
    left_over_m, scatter_m = _worst_m(left_over), ends.scatter_m
    if left_over_m > side_m / 2:
        raise ArgumentError(
            f"no E_b and E_d explain the ends of the squares: {left_over_m:.2f} m of {ends.error_m:.2f} m remain. "
            "Was the robot blocked, or x, y or the side measured differently?"
        )
    chance_m = side_m * _CHANCE if scatter_m is None else max(_DOUBT * scatter_m, _FINE_M)
    return Fit(_calibration_of(*unknowns), left_over_m, steps, is_doubtful=left_over_m > chance_m)


def _gauss_newton(residuals: Residuals, unknowns: Vector, left_over: Vector) -> Vector:
    """Return the change that solves the linearised problem; raise ArgumentError if the unknowns look the same."""
    slopes = [_slope(residuals, unknowns, index) for index in range(2)]
    (a, b), (_, d) = [[_dot(one, other) for other in slopes] for one in slopes]
    e, f = (-_dot(slope, left_over) for slope in slopes)
    determinant = a * d - b * b
    if determinant <= _SINGULAR * a * d:
        raise ArgumentError("squares of this size cannot tell E_b and E_d apart: are the side and the wheelbase right?")
    return [(e * d - b * f) / determinant, (a * f - b * e) / determinant]


def _slope(residuals: Residuals, unknowns: Vector, index: int) -> Vector:
    """Return the derivative of the residuals by one of the unknowns."""
    more, less = list(unknowns), list(unknowns)
    more[index] += _NUDGE
    less[index] -= _NUDGE
    return [(high - low) / (2 * _NUDGE) for high, low in zip(residuals(more), residuals(less), strict=True)]


def _line_search(residuals: Residuals, unknowns: Vector, change: Vector, left_over: Vector) -> tuple[Vector, Vector]:
    """Halve the change until the residuals do not grow; return the new unknowns and residuals.

    Raises ArgumentError if every fraction of the change leads to an impossible calibration.
    """
    for halvings in range(_MOST_HALVINGS):
        nearer = [unknown + part / 2**halvings for unknown, part in zip(unknowns, change, strict=True)]
        try:
            smaller = residuals(nearer)
        except ArgumentError:  # an impossible calibration
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
