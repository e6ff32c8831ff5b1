"""A sight of a marker by one camera, its prediction, and the fusion of several cameras."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from .lens import Floats
from .locating import SquareFit

_SPEED_SHARE: Final = 0.5
"""Weight of a new measurement of the speed."""
_ACCELERATION_M_S2: Final = 1.0
"""Of robots: the uncertainty of a prediction."""
_TURN_ACCELERATION_RAD_S2: Final = 8.0
_MOST_DISTANCE: Final = 5.0
"""Distance between the poses by two cameras, in standard deviations, over which they disagree."""


@dataclass(frozen=True)
class Sighting:
    """A marker in the map frame.

    Attributes:
        corners: in pixels, (4, 2).
        stamp_s: time of exposure.
        speed: of x, y and yaw, in m/s and rad/s, (3,).
    """

    number: int
    fit: SquareFit
    corners: Floats
    stamp_s: float
    speed: Floats

    @property
    def pose(self) -> Floats:
        """x_m, y_m and yaw_rad, (3,)."""
        return np.array([self.fit.x_m, self.fit.y_m, self.fit.yaw_rad])

    def after(self, former: Sighting | None) -> Sighting:
        """Return the sighting with the speed since a former one."""
        if former is None or not 0 < self.stamp_s - former.stamp_s < 0.5:
            return self
        way = self.pose - former.pose
        way[2] = math.remainder(way[2], math.tau)
        speed = former.speed + _SPEED_SHARE * (way / (self.stamp_s - former.stamp_s) - former.speed)
        return replace(self, speed=speed)

    def at(self, stamp_s: float) -> tuple[Floats, Floats]:
        """Return the predicted pose, (3,), and its covariance, (3, 3), at another time."""
        away_s = stamp_s - self.stamp_s
        pose = self.pose + self.speed * away_s
        spread = np.array([_ACCELERATION_M_S2, _ACCELERATION_M_S2, _TURN_ACCELERATION_RAD_S2]) * (away_s**2 / 2)
        return pose, self.fit.covariance + np.diag(spread**2)


def fuse(sightings: Sequence[Sighting], stamp_s: float) -> tuple[Floats, Floats] | None:
    """Return one pose, (3,), and its covariance, (3, 3), of a marker that several cameras see.

    Returns:
        None if two cameras disagree, so that it is unknown which one is right.
    """
    pose, covariance = sightings[0].at(stamp_s)
    for sighting in sightings[1:]:
        other, other_covariance = sighting.at(stamp_s)
        away = other - pose
        away[2] = math.remainder(away[2], math.tau)
        both = covariance + other_covariance
        if away @ np.linalg.solve(both, away) > _MOST_DISTANCE**2:
            return None
        gain = np.linalg.solve(both, covariance).T
        pose = pose + gain @ away
        covariance = covariance - gain @ covariance
    pose[2] = math.remainder(pose[2], math.tau)
    return pose, (covariance + covariance.T) / 2
