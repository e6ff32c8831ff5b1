"""Odometry of an EvBot: dead reckoning from its encoder counts."""

from __future__ import annotations

import threading

from eal_actors.plugin import (
    DataType,
    EALData,
    Localizer,
    Resource,
    ResourceType,
    ValueInfo,
    WheelCalibration,
    finite_pose,
    request,
)

from ..roomba.odometry import DeadReckoning
from .messages import BaseWelcome
from .session import BaseSession
from .session_state import StatusReading

_COUNTS = 1 << 32


class Odometer:
    """Dead reckoning from the encoders of a base, across its restarts.

    Args:
        track_m: nominal distance of the wheels.
        localizer: receives the pose at each status.

    Attributes:
        calibration: the wheel calibration for later counts.

    Thread: any.
    """

    def __init__(self, track_m: float, calibration: WheelCalibration, localizer: Localizer) -> None:
        self.calibration = calibration
        self._localizer = localizer
        self._lock = threading.Lock()
        self._reckoning = DeadReckoning(track_m)
        self._counted: tuple[int, int] | None = None
        self._boot: int | None = None
        self._travel_m = (0.0, 0.0)
        self._stamp_s = 0.0

    def follow(self, welcome: BaseWelcome, reading: StatusReading) -> None:
        """Update the pose from a status."""
        counted = reading.wheels.left, reading.wheels.right
        with self._lock:
            if self._counted is not None and self._boot == welcome.boot:
                self._add(
                    [_difference(*pair) * welcome.step_um / 1e6 for pair in zip(counted, self._counted, strict=True)]
                )
            self._counted, self._boot = counted, welcome.boot
            self._stamp_s = reading.stamp_s
            self._localizer.odometry(*self._reckoning.pose, reading.stamp_s)

    def _add(self, gone_m: list[float]) -> None:
        left_m, right_m = gone_m
        self._travel_m = self._travel_m[0] + left_m, self._travel_m[1] + right_m
        ahead_m, arc_m = self.calibration.travelled(left_m, right_m)
        self._reckoning.add(ahead_m - arc_m, ahead_m + arc_m)

    @property
    def travel_m(self) -> tuple[float, float]:
        """The totals of the left and the right encoder since the first reading."""
        return self._travel_m

    @property
    def pose(self) -> tuple[float, float, float]:
        """The pose: x in m, y in m, yaw in rad, in (-pi, pi]."""
        with self._lock:
            return self._reckoning.pose

    def place(self, x_m: float, y_m: float, yaw_rad: float) -> None:
        """Set the pose."""
        with self._lock:
            self._reckoning.place(x_m, y_m, yaw_rad)
            self._localizer.restart_odometry(x_m, y_m, yaw_rad, self._stamp_s)


def _difference(count: int, before: int) -> int:
    """Return the difference of a counter modulo 2^32."""
    return (count - before + _COUNTS // 2) % _COUNTS - _COUNTS // 2


class Odometry(Resource):
    """Pose by dead reckoning from the wheel encoders: x in m, y in m, yaw in rad, from (0, 0, 0) at first."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape=(3,), description="x_m, y_m, yaw_rad")

    def __init__(self, session: BaseSession, odometer: Odometer) -> None:
        self._session = session
        self._odometer = odometer

    def not_ready(self) -> str | None:
        """Return why the base cannot be read now."""
        return self._session.why_not_ready()

    def get_value(self) -> EALData:
        """Return [x_m, y_m, yaw_rad], yaw in (-pi, pi]."""
        stamp_s = self._session.latest().stamp_s
        return EALData.of(self._odometer.pose, frame_id=f"{self._session.name}/odom", stamp_s=stamp_s)

    def set_value(self, data: EALData) -> None:
        """Set the pose to continue from.

        Raises:
            ArgumentError: a number is not finite.
        """
        self._odometer.place(*finite_pose(data))

    @request("travel", ValueInfo(DataType.DOUBLE, "m", shape=(2,)))
    def travel(self) -> EALData:
        """Return the totals of the left and the right encoder since the start."""
        stamp_s = self._session.latest().stamp_s
        return EALData.of(self._odometer.travel_m, unit="m", stamp_s=stamp_s)
