"""PoseEstimate: where a robot is, how sure that is, and when it was there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self, TypeAlias

from typing_extensions import override

from eal_actors.device.data import EALData
from eal_actors.kernel.errors import ArgumentError

MAP_FRAME: Final = "map"
"""The frame of all pose estimates of a fleet: metres, x right, y up, yaw counter-clockwise from x."""

Point: TypeAlias = tuple[float, float]
"""x and y in m."""
Pose: TypeAlias = tuple[float, float, float]
"""x and y in m, yaw in rad, counter-clockwise from x."""
Row: TypeAlias = tuple[float, float, float]
Covariance: TypeAlias = tuple[Row, Row, Row]
"""Of x, y and yaw, in m², m·rad and rad². Plain numbers: small boards have no numpy."""

_LENGTH: Final = 12
_ROUNDING: Final = 1e-9


_FARTHEST_M: Final = 1e6


def is_plausible(x_m: float, y_m: float, yaw_rad: float) -> bool:
    """Return whether a robot's own numbers can be its pose: finite, and within 1,000 km of where it counts from."""
    return math.isfinite(yaw_rad) and abs(x_m) <= _FARTHEST_M and abs(y_m) <= _FARTHEST_M


def wrapped_rad(angle_rad: float) -> float:
    """Return the same direction in (-pi, pi]."""
    wrapped = math.remainder(angle_rad, math.tau)
    return math.pi if wrapped == -math.pi else wrapped


def diagonal(position_std_m: float, yaw_std_rad: float) -> Covariance:
    """Return the covariance of independent errors of x, y and yaw with these standard deviations."""
    position, yaw = position_std_m**2, yaw_std_rad**2
    return (position, 0.0, 0.0), (0.0, position, 0.0), (0.0, 0.0, yaw)


@dataclass(frozen=True, slots=True)
class PoseEstimate:
    """The pose of a robot with its uncertainty.

    Attributes:
        yaw_rad: counter-clockwise from the frame's x axis, in (-pi, pi].
        covariance: of x, y and yaw, in m², m·rad and rad², row by row.
        stamp_s: when the robot was there, in seconds of the fleet's clock.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    covariance: Covariance
    stamp_s: float
    frame_id: str = MAP_FRAME

    @property
    def position_std_m(self) -> float:
        """The standard deviation of the position in its most uncertain direction."""
        (xx, xy, _), (_, yy, _), _ = self.covariance
        return math.sqrt(max(0.0, (xx + yy) / 2 + math.hypot((xx - yy) / 2, xy)))

    @property
    def yaw_std_rad(self) -> float:
        """The standard deviation of the yaw."""
        return math.sqrt(max(0.0, self.covariance[2][2]))

    @classmethod
    def of_numbers(cls, numbers: Sequence[float], stamp_s: float) -> Self:
        """Return the estimate in twelve numbers: x, y, yaw and the covariance row by row.

        Raises ArgumentError if they are no pose with a covariance.
        """
        if len(numbers) != _LENGTH:
            raise ArgumentError(f"a pose with its covariance has {_LENGTH} numbers, not {len(numbers)}")
        x_m, y_m, yaw_rad, *rest = map(float, numbers)
        if not all(map(math.isfinite, (x_m, y_m, yaw_rad, *rest))):
            raise ArgumentError("a pose with its covariance must consist of finite numbers")
        rows = (rest[0], rest[1], rest[2]), (rest[3], rest[4], rest[5]), (rest[6], rest[7], rest[8])
        _check_covariance(rows)
        return cls(x_m, y_m, wrapped_rad(yaw_rad), rows, stamp_s)

    @override
    def __repr__(self) -> str:
        """Return the pose for people: rounded, with standard deviations in place of the covariance."""
        x_m, y_m, yaw_rad = (round(number, 4) + 0.0 for number in (self.x_m, self.y_m, self.yaw_rad))
        spread = f"position_std_m={self.position_std_m:.2g}, yaw_std_rad={self.yaw_std_rad:.2g}"
        when = f"stamp_s={self.stamp_s:.2f}, frame_id={self.frame_id!r}"
        return f"PoseEstimate(x_m={x_m}, y_m={y_m}, yaw_rad={yaw_rad}, {spread}, {when})"

    def numbers(self) -> list[float]:
        """Return x, y, yaw and the covariance row by row."""
        return [self.x_m, self.y_m, self.yaw_rad, *(value for row in self.covariance for value in row)]

    def __eal_data__(self) -> EALData:
        """Return the pose without its covariance: [x_m, y_m, yaw_rad]."""
        return EALData.of([self.x_m, self.y_m, self.yaw_rad], frame_id=self.frame_id, stamp_s=self.stamp_s)


def _check_covariance(rows: Covariance) -> None:
    """Raise ArgumentError unless the matrix is symmetric and positive definite."""
    (a, b, c), (b2, d, e), (c2, e2, f) = rows
    scale = max(abs(a), abs(d), abs(f), _ROUNDING)
    if max(abs(b - b2), abs(c - c2), abs(e - e2)) > _ROUNDING * scale:
        raise ArgumentError("the covariance of a pose must be symmetric")
    determinant = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    if not (a > 0.0 and a * d - b * b > 0.0 and determinant > 0.0):
        raise ArgumentError("the covariance of a pose must be positive definite")
