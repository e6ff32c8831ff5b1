"""The square test of Borenstein and Feng (UMBmark): what the ends of squares driven both ways say of a base.

Source: J. Borenstein and L. Feng, "Measurement and Correction of Systematic Odometry Errors in Mobile Robots", IEEE
Transactions on Robotics and Automation 12 (6), 1996.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean, variance
from typing import TypeAlias

from pydantic import ValidationError

from eal_actors.device.differential_base import WheelCalibration
from eal_actors.kernel.errors import ArgumentError
from eal_actors.lab.calibration.square import WAYS, Way

Point: TypeAlias = tuple[float, float]
"""x and y in metres."""


@dataclass(frozen=True, slots=True)
class SquareEnds:
    """Where squares ended, less where the base believed that they did: x along the first side, y to its left.

    Attributes:
        cw: of squares with turns to the right, in metres.
        ccw: of squares with turns to the left, in metres.

    Raises:
        ArgumentError: there are none of one way, or one is no number.
    """

    cw: Sequence[Point]
    ccw: Sequence[Point]

    def __post_init__(self) -> None:
        for way in WAYS:
            if not self.of(way):
                raise ArgumentError(f"no square {way} was measured: the test needs squares both ways")
            for number, (x_m, y_m) in enumerate(self.of(way), start=1):
                if not (math.isfinite(x_m) and math.isfinite(y_m)):
                    raise ArgumentError(f"square {number} {way} ended at x {x_m} m, y {y_m} m, which is no place")

    def of(self, way: Way) -> Sequence[Point]:
        """Return the ends of one way."""
        return self.cw if way == "cw" else self.ccw

    def centre(self, way: Way) -> Point:
        """Return the centre of gravity of the ends of one way."""
        return fmean(x_m for x_m, _ in self.of(way)), fmean(y_m for _, y_m in self.of(way))

    @property
    def error_m(self) -> float:
        """E_max,syst: how far the farther one of the two centres of gravity is off."""
        return max(math.hypot(*self.centre(way)) for way in WAYS)

    @property
    def scatter_m(self) -> float | None:
        """How far a centre of gravity is off by chance alone, one standard deviation; None for single squares."""
        if min(len(self.of(way)) for way in WAYS) < 2:
            return None
        return math.sqrt(max(sum(variance(axis) for axis in self._axes(way)) / len(self.of(way)) for way in WAYS))

    def _axes(self, way: Way) -> tuple[list[float], list[float]]:
        return [x_m for x_m, _ in self.of(way)], [y_m for _, y_m in self.of(way)]


def closed_form(ends: SquareEnds, side_m: float, wheelbase_m: float) -> WheelCalibration:
    """Return what the ends say to first order, of a base that knows of no calibration.

    Good for wheels, whose errors are within a few percent; tracks skid by more than that, see `fit`.

    Raises:
        ArgumentError: the errors are larger than any base has.
    """
    require_sizes(side_m, wheelbase_m)
    (x_cw, y_cw), (x_ccw, y_ccw) = (ends.centre(way) for way in WAYS)
    alpha_rad = fmean(((x_cw + x_ccw) / (-4 * side_m), (y_cw - y_ccw) / (-4 * side_m)))
    beta_rad = fmean(((x_cw - x_ccw) / (-4 * side_m), (y_cw + y_ccw) / (-4 * side_m)))
    track_factor = (math.pi / 2) / (math.pi / 2 - alpha_rad)
    half_m = wheelbase_m / 2
    # (R + b/2) / (R - b/2) with R = (L/2) / sin(beta/2), which is infinite where the sides are straight
    bend = half_m * math.sin(beta_rad / 2) / (side_m / 2)
    return calibration_of(track_factor, (1 + bend) / (1 - bend))


def calibration_of(track_factor: float, wheel_ratio: float) -> WheelCalibration:
    """Return a calibration of numbers that were measured.

    Raises:
        ArgumentError: one is outside what a base can have.
    """
    try:
        return WheelCalibration(track_factor=track_factor, wheel_ratio=wheel_ratio)
    except ValidationError:
        raise ArgumentError(
            f"the squares say E_b {track_factor:.4g} and E_d {wheel_ratio:.4g}, which no base has: was the way "
            "blocked, a square not driven to its end, or x, y or the side measured otherwise?"
        ) from None


def require_sizes(side_m: float, wheelbase_m: float) -> None:
    """Require lengths that a square and a base can have.

    Raises:
        ArgumentError: one is not over 0, or no number.
    """
    for what, length_m in (("side", side_m), ("wheelbase", wheelbase_m)):
        if not (math.isfinite(length_m) and length_m > 0):
            raise ArgumentError(f"the {what} must be over 0 m, not {length_m:g} m")
