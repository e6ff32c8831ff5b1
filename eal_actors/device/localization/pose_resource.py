"""PoseResource: the resource `Pose` of a robot, the face of its Localizer."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from typing_extensions import override

from eal_actors.device.data import DataType, EALData
from eal_actors.device.info import CommandInfo, ResourceInfo, ResourceType, ValueInfo
from eal_actors.device.localization.localizer import FixOutcome, Localizer
from eal_actors.device.localization.pose_estimate import PoseEstimate, is_plausible
from eal_actors.device.resource import Resource, request
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import ArgumentError

_ESTIMATE: Final = ValueInfo(
    DataType.DOUBLE, shape=(12,), description="x_m, y_m, yaw_rad, and their covariance row by row"
)

_FIX: Final = CommandInfo(
    "fix", _ESTIMATE, description="Correct the estimate by a pose and its covariance, measured at the data's stamp_s."
)


class PoseResource(Resource):
    """The estimated x in m, y in m and yaw in rad, in (-pi, pi], counter-clockwise from the map's x axis."""

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
        """Set the estimate: the robot is there now. Raises ArgumentError if a number is not finite."""
        self._localizer.place(*finite_pose(data))

    @override
    def send_cmd(self, cmd: str, data: EALData | None = None) -> int:
        """Execute `fix`, the only command: correct the estimate at the time of the data.

        Returns 1 if the fix is applied, or waits for the odometry of its time; 0 if it is refused. Raises ArgumentError
        if there is no such command, or the data are no pose with a covariance and a time.
        """
        self.info().parse_command(cmd, data)
        if data is None or data.stamp_s is None:
            raise ArgumentError("a fix needs stamp_s, the time of its exposure")
        outcome = self._localizer.fix(PoseEstimate.of_numbers(list(data.value), data.stamp_s))
        return 0 if outcome is FixOutcome.REFUSED else 1

    @override
    def _make_info(self) -> ResourceInfo:
        """Add the command `fix`, which needs the time of its data and so is no method under `@command`."""
        return replace(super()._make_info(), commands=(_FIX,))

    @request("estimate", _ESTIMATE)
    def estimate(self) -> EALData:
        """Return the pose and its covariance."""
        estimate = self._localizer.estimate(self._clock.now())
        return EALData.of(estimate.numbers(), frame_id=estimate.frame_id, stamp_s=estimate.stamp_s)


def finite_pose(data: EALData) -> tuple[float, float, float]:
    """Return the pose [x_m, y_m, yaw_rad] in a value.

    Raises ArgumentError if a number is not finite, or the place is over 1,000 km away.
    """
    x_m, y_m, yaw_rad = (float(number) for number in data.value)
    if not is_plausible(x_m, y_m, yaw_rad):
        raise ArgumentError(
            f"a pose must consist of finite numbers, within 1,000 km, not {x_m:g}, {y_m:g}, {yaw_rad:g}"
        )
    return x_m, y_m, yaw_rad
