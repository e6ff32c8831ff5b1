"""The odometry of a ROS 2 robot: the newest pose and twist, which also feed the pose estimate."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from typing import Any, Final

from eal_actors.plugin import (
    Activity,
    Clock,
    DataError,
    DataType,
    EALData,
    Localizer,
    LogLimit,
    OdometryNoise,
    Resource,
    ResourceType,
    UnavailableError,
    ValueInfo,
    get_logger,
    is_plausible,
    wrapped_rad,
)

from . import graph
from .endpoints import RosSubscription
from .session import RosSession
from .stamps import StampOffset

_POLL_S: Final = 0.02
_STILL_M_S: Final = 0.005
_STILL_RAD_S: Final = 0.01


def yaw_of(rotation: Any) -> float:
    """Return the yaw of a quaternion, in rad; NaN if it is no rotation."""
    if not 0.9 < math.hypot(rotation.x, rotation.y, rotation.z, rotation.w) < 1.1:
        return math.nan
    sine = 2.0 * (rotation.w * rotation.z + rotation.x * rotation.y)
    return math.atan2(sine, 1.0 - 2.0 * (rotation.y * rotation.y + rotation.z * rotation.z))


@dataclass(frozen=True, slots=True)
class RosOdometryReading:
    """One message of odometry.

    Attributes:
        x_m: position in its frame.
        y_m: likewise.
        yaw_rad: heading, not wrapped: it counts turns.
        speed_m_s: ahead.
        turn_rate_rad_s: to the left.
        stamp_s: by the fleet's clock.
        frame_id: the frame.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    speed_m_s: float
    turn_rate_rad_s: float
    stamp_s: float
    frame_id: str

    @property
    def is_still(self) -> bool:
        """Whether the robot stands."""
        return abs(self.speed_m_s) < _STILL_M_S and abs(self.turn_rate_rad_s) < _STILL_RAD_S


class RosOdometer:
    """Reads the odometry of one robot. Thread: any."""

    def __init__(
        self,
        session: RosSession,
        subscription: RosSubscription,
        clock: Clock,
        localizer: Localizer,
        noise: OdometryNoise,
        timeout_s: float,
    ) -> None:
        self._session = session
        self._subscription = subscription
        self._clock = clock
        self._localizer = localizer
        self._timeout_s = timeout_s
        self._lock = threading.Lock()
        self._offset = StampOffset()
        self._latest: RosOdometryReading | None = None
        self._problem: str | None = None
        self._ignored = LogLimit()
        localizer.attach(noise, refresh=self.refresh, not_ready=self.why_not_ready)

    def refresh(self) -> None:
        """Take the messages that have arrived."""
        with self._lock:
            while True:
                try:
                    received = self._subscription.take()
                    if received is None:
                        return
                    self._follow(received.message)
                    self._problem = None
                except DataError as error:
                    self._note(error)

    def _note(self, error: DataError) -> None:
        if self._problem is None and (more := self._ignored.admit()) is not None:
            get_logger(robot=self._localizer.robot).warning("odometry is ignored", reason=error.message, **more)
        self._problem = error.message

    def _follow(self, message: Any) -> None:
        pose, twist = message.pose.pose, message.twist.twist
        numbers = (
            pose.position.x, pose.position.y, yaw_of(pose.orientation), twist.linear.x, twist.angular.z
        )  # fmt: skip
        if not all(map(math.isfinite, numbers)):
            raise DataError(
                f"{self._subscription.topic}: the pose or twist is not finite, or the orientation no rotation"
            )
        if not is_plausible(*numbers[:3]):
            raise DataError(f"{self._subscription.topic}: the position is over 1,000 km from the start")
        stamp = message.header.stamp
        stamp_s = self._offset.fleet_s(stamp.sec + stamp.nanosec / 1e9, self._clock.now())
        x_m, y_m, yaw_rad, speed_m_s, rate_rad_s = numbers
        before = self._latest
        if before is not None:
            yaw_rad = before.yaw_rad + wrapped_rad(yaw_rad - before.yaw_rad)
        self._latest = RosOdometryReading(
            x_m, y_m, yaw_rad, speed_m_s, rate_rad_s, stamp_s, message.header.frame_id or "odom"
        )
        self._localizer.odometry(x_m, y_m, wrapped_rad(yaw_rad), stamp_s)

    def why_not_ready(self) -> str | None:
        """Return why there is no odometry now."""
        topic, latest = self._subscription.topic, self._latest
        age_s = math.inf if latest is None else self._clock.now() - latest.stamp_s
        if age_s <= self._timeout_s:
            return None
        problem = self._session.why_absent(graph.PUBLISHER, topic, self._subscription.kind) or self._problem
        return problem or (f"no message on {topic}" + ("" if latest is None else f" for {age_s:.1f} s"))

    def read(self) -> RosOdometryReading:
        """Return the newest odometry.

        Raises:
            UnavailableError: it is too old.
        """
        self.refresh()
        latest, problem = self._latest, self.why_not_ready()
        if latest is None or problem:
            raise UnavailableError(problem or "no odometry has arrived")
        return latest


class Odometry(Resource):
    """The pose by the robot's own odometry: x in m, y in m, yaw in rad."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape=(3,), description="x_m, y_m, yaw_rad")

    def __init__(self, odometer: RosOdometer) -> None:
        self._odometer = odometer

    def not_ready(self) -> str | None:
        """Return why there is no odometry now."""
        return self._odometer.why_not_ready()

    def background(self) -> Activity:
        """Take the messages as they arrive, so that the pose estimate has them all."""
        while True:
            self._odometer.refresh()
            yield _POLL_S

    def get_value(self) -> EALData:
        """Return [x_m, y_m, yaw_rad], yaw in (-pi, pi]."""
        now = self._odometer.read()
        return EALData.of([now.x_m, now.y_m, wrapped_rad(now.yaw_rad)], frame_id=now.frame_id, stamp_s=now.stamp_s)
