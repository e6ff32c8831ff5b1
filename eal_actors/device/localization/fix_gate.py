"""FixGate: which fixes are believed, and when the robot must have been carried away.

A fix that jumps is refused. If one fix after the other is refused but they agree with one another and with the odometry
between them, it is the estimate that is wrong: the robot was carried, or the estimate was lost.
"""

from __future__ import annotations

from typing import Final

from eal_actors.device.localization.odometry_noise import OdometryNoise
from eal_actors.device.localization.pose_estimate import Covariance, Pose, PoseEstimate
from eal_actors.device.localization.pose_filter import FilterState, between, distance, predict
from eal_actors.device.localization.pose_history import Moment

GATE: Final = 25.0
"""Greatest squared Mahalanobis distance of a believed fix; 15 of a million true ones are beyond (chi-square of 3)."""
CONSISTENT_FIXES: Final = 5
"""So many consistent refused fixes in a row move the estimate to them."""
CONSISTENT_S: Final = 0.25
"""They must be spread over this time at least: one bad picture is no evidence."""
INFLATION: Final = 9.0
"""Factor of the covariance of a fix from which the estimate begins again."""


class FixGate:
    """The gate of one robot. Thread: one at a time."""

    def __init__(self) -> None:
        self._chain: list[tuple[PoseEstimate, Pose]] = []

    def admits(self, moment: Moment, fix: PoseEstimate) -> bool:
        """Return whether a fix fits the estimate at its time."""
        is_near = distance(moment.state, fix) <= GATE
        if is_near:
            self._chain.clear()
        return is_near

    def must_begin_again(self, moment: Moment, fix: PoseEstimate, noise: OdometryNoise) -> bool:
        """Note a refused fix; return whether enough of them agree to begin again from it."""
        if self._chain:
            former, odometry = self._chain[-1]
            pose = former.x_m, former.y_m, former.yaw_rad
            moved = predict(FilterState.at(pose, former.covariance, noise), between(odometry, moment.odometry), noise)
            if fix.stamp_s <= former.stamp_s or distance(moved, fix) > GATE:
                self._chain.clear()
        self._chain.append((fix, moment.odometry))
        first, _ = self._chain[0]
        is_enough = len(self._chain) >= CONSISTENT_FIXES and fix.stamp_s - first.stamp_s >= CONSISTENT_S
        if is_enough:
            self._chain.clear()
        return is_enough

    def forget(self) -> None:
        """Forget the refused fixes: the odometry began anew."""
        self._chain.clear()


def inflated(covariance: Covariance) -> Covariance:
    """Return the covariance of an estimate that begins again from a fix."""
    one, two, three = (tuple(INFLATION * value for value in row) for row in covariance)
    return (one[0], one[1], one[2]), (two[0], two[1], two[2]), (three[0], three[1], three[2])
