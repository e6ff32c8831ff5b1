"""The errors of a make's odometry, as the filter expects them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

_TURN_RAD: Final = math.pi / 2
_CALIBRATED_SHARE: Final = 0.005
_CALIBRATED_TURN_SHARE: Final = 0.02


@dataclass(frozen=True, slots=True)
class OdometryNoise:
    """The errors of odometry: random ones, and constant ones that the filter estimates beside the pose.

    The random error of a wheel is white noise over its travel, so its variance grows with the distance. The constant
    errors are the ones of Borenstein and Feng: unequal wheels and an unknown effective track.

    Attributes:
        track_m: nominal distance of the wheels.
        scatter_m: random error of each wheel: its standard deviation after 1 m.
        turn_scatter_rad: standard deviation that a turn in place by 90 degrees adds.
        scale_share: standard deviation of the constant error of distances, as a share.
        drift_rad_m: standard deviation of the constant turn per metre ahead.
        turn_share: standard deviation of the constant error of turns, as a share.

    Source: L. Kleeman, "Odometry Error Covariance Estimation for Two Wheel Robot Vehicles", 1995; J. Borenstein and
    L. Feng, "UMBmark: A Method for Measuring, Comparing, and Correcting Dead-reckoning Errors", 1994.
    """

    track_m: float = 0.25
    scatter_m: float = 0.002
    turn_scatter_rad: float = 0.005
    scale_share: float = 0.01
    drift_rad_m: float = 0.02
    turn_share: float = 0.02

    def variances(self, ahead_m: float, turn_rad: float) -> tuple[float, float]:
        """Return the variances, in m² and rad², that a short motion adds to distance and yaw."""
        arc_m = turn_rad * self.track_m / 2
        wheels = self.scatter_m**2 * (abs(ahead_m - arc_m) + abs(ahead_m + arc_m))
        in_place = max(0.0, abs(turn_rad) - 2 * abs(ahead_m) / self.track_m)
        return wheels / 4, wheels / self.track_m**2 + self.turn_scatter_rad**2 * in_place / _TURN_RAD

    def calibrated(self) -> OdometryNoise:
        """Return the errors that remain after a calibration of the wheels."""
        return replace(
            self,
            scale_share=min(self.scale_share, _CALIBRATED_SHARE),
            drift_rad_m=min(self.drift_rad_m, _CALIBRATED_SHARE / self.track_m),
            turn_share=min(self.turn_share, _CALIBRATED_TURN_SHARE),
        )
