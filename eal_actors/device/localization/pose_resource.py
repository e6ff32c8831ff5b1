"""PoseResource: the resource `Pose` of a robot, the face of its Localizer."""

from __future__ import annotations

import math
from typing import Final

from typing_extensions import override

from eal_actors.device.data import DataType, EALData, ValueInfo
from eal_actors.device.info import ResourceType
from eal_actors.device.localization.localizer import Localizer
from eal_actors.device.resource import Resource, request
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import ArgumentError

_ESTIMATE: Final = ValueInfo(
    DataType.DOUBLE, shape=(12,), description="x_m, y_m, yaw_rad, and their covariance row by row"
)


class PoseResource(Resource):
    """The estimated x in m, y in m and yaw in rad, in (-pi, pi], counter-clockwise from the map's x axis.

    Args:
        localizer: of the robot.
        clock: the fleet's clock.
    """

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape=(3,), description="x_m, y_m, yaw_rad")

    def __init__(self, localizer: Localizer, clock: Clock) -> None:
        self._localizer = localizer
        self._clock = clock

    @override
    def not_ready(self) -> str | None:
        return self._localizer.not_ready()

    def get_value(self) -> EALData:
        """Return [x_m, y_m, yaw_rad]."""
        return EALData.of(self._localizer.estimate(self._clock.now()))

    @override
    def glance(self) -> EALData:
        return self.get_value()

    def set_value(self, data: EALData) -> None:
        """Set the estimate: the robot is there now.

        Raises:
            ArgumentError: a number is not finite.
        """
        self._localizer.place(*finite_pose(data))

    @request("estimate", _ESTIMATE)
    def estimate(self) -> EALData:
        """Return the pose and its covariance."""
        estimate = self._localizer.estimate(self._clock.now())
        return EALData.of(estimate.numbers(), frame_id=estimate.frame_id, stamp_s=estimate.stamp_s)


def finite_pose(data: EALData) -> tuple[float, float, float]:
    """Return the pose [x_m, y_m, yaw_rad] in a value.

    Raises:
        ArgumentError: a number is not finite.
    """
    x_m, y_m, yaw_rad = (float(number) for number in data.value)
    if not all(map(math.isfinite, (x_m, y_m, yaw_rad))):
        raise ArgumentError(f"a pose must consist of finite numbers, not {x_m:g}, {y_m:g}, {yaw_rad:g}")
    return x_m, y_m, yaw_rad
