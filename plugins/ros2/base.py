"""The base of a ROS 2 robot: velocities on cmd_vel, closed by its odometry, with a watchdog of our own.

A robot's own watchdog stops it when velocities cease, such as when this process is killed; `follow` and every motion
also end by a velocity of zero. A halt that the link cannot carry is repeated until the link is back.
"""

from __future__ import annotations

import math
import time
from typing import Any

from typing_extensions import override

from eal_actors.plugin import (
    Activity,
    Drivetrain,
    PluginContext,
    VelocityBase,
)

from .endpoints import RosPublisher
from .navigation import Navigator
from .odometry import RosOdometer, RosOdometryReading


class Base(VelocityBase):
    """Drives the robot; get_status: 0 stands, 1 moves.

    Args:
        navigator: drives to a place by Nav2; None for our own closed loop.
        stamped: whether velocities carry a header.
    """

    def __init__(
        self,
        drivetrain: Drivetrain,
        context: PluginContext,
        publisher: RosPublisher,
        odometer: RosOdometer,
        navigator: Navigator | None,
        *,
        stamped: bool,
    ) -> None:
        super().__init__(drivetrain, context)
        self._publisher = publisher
        self._odometer = odometer
        self._navigator = navigator
        self._stamped = stamped
        self._localizer = context.localizer

    @override
    def not_ready(self) -> str | None:
        return self._odometer.why_not_ready()

    @override
    def halt(self) -> None:
        if self._navigator is not None:
            self._navigator.cancel()
        super().halt()

    @override
    def background(self) -> Activity:
        for pause_s in super().background():
            if self._navigator is not None:
                self._navigator.look_after()
            yield pause_s

    @override
    def go_to(self, goal: Any) -> Activity:
        if self._navigator is None:
            return super().go_to(goal)
        x_m, y_m, yaw_rad = self.goal_numbers(goal)
        if yaw_rad is None:  # NavigateToPose has no free heading: arrive as the robot comes
            here = self._localizer.estimate(self._clock.now())
            yaw_rad = math.atan2(y_m - here.y_m, x_m - here.x_m)
        return self._navigator.go_to(x_m, y_m, yaw_rad, self.progress)

    @override
    def read_odometry(self) -> RosOdometryReading:
        return self._odometer.read()

    @override
    def send_velocity(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        twist = {"linear": {"x": speed_m_s}, "angular": {"z": turn_rate_rad_s}}
        if self._stamped:
            sec, nanosec = divmod(time.time_ns(), 1_000_000_000)
            self._publisher.publish({"header": {"stamp": {"sec": sec, "nanosec": nanosec}}, "twist": twist})
        else:
            self._publisher.publish(twist)
