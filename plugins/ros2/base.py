"""The base of a ROS 2 robot: velocities on cmd_vel, closed by its odometry, with a watchdog of our own.

A robot's own watchdog stops it when velocities cease, such as when this process is killed; `follow` and every motion
also end by a velocity of zero. A halt that the link cannot carry is repeated until the link is back.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from typing import Any, Final

from typing_extensions import override

from eal_actors.plugin import (
    Activity,
    ArgumentError,
    DifferentialBase,
    Drivetrain,
    PluginContext,
    ResourceFaultError,
    UnavailableError,
    UnsupportedError,
    WheelCalibration,
)

from .endpoints import RosPublisher
from .navigation import Navigator
from .odometry import RosOdometer, RosOdometryReading

_PERIOD_S: Final = 0.05
_STUCK_S: Final = 3.0
"""Seconds of a motion without any progress by the odometry after which it is given up."""
_SETTLE_S: Final = 1.0
_CREEP: Final = 0.1
"""The least share of the usual speed, near the end of a motion."""
_REPEATS: Final = 3
"""Velocities of zero after a halt: one may be dropped at a full link."""


class Base(DifferentialBase):
    """Drives the robot; get_status: 0 stands, 1 moves.

    Args:
        drivetrain: from the settings.
        context: of the plugin.
        publisher: of the velocities.
        odometer: closes the motions.
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
        self._clock = context.clock
        self._publisher = publisher
        self._odometer = odometer
        self._navigator = navigator
        self._stamped = stamped
        self._zeros_due = 0

    @property
    @override
    def calibration(self) -> WheelCalibration:
        return WheelCalibration()

    @calibration.setter
    def calibration(self, calibration: WheelCalibration) -> None:
        if calibration != WheelCalibration():
            raise UnsupportedError("a ROS 2 robot calibrates its own wheels: set it in the robot's driver")

    @override
    def not_ready(self) -> str | None:
        return self._odometer.why_not_ready()

    def get_status(self) -> int:
        """Return 0 while it stands, 1 while it moves."""
        return 0 if self._odometer.read().is_still else 1

    @override
    def halt(self) -> None:
        if self._navigator is not None:
            self._navigator.cancel()
        self._zeros_due = _REPEATS
        self._send_zero()

    @override
    def background(self) -> Activity:
        """Repeat the velocity of zero after a halt."""
        while True:
            if self._zeros_due:
                self._send_zero()
            yield _PERIOD_S

    @override
    def go_to(self, goal: Any) -> Activity:
        if self._navigator is None:
            return super().go_to(goal)
        numbers = [float(number) for number in goal]
        if len(numbers) not in (2, 3) or not all(map(math.isfinite, numbers)):
            raise ArgumentError(f"goto needs finite numbers x_m, y_m and perhaps yaw_rad, not {numbers}")
        if len(numbers) == 2:  # NavigateToPose has no free heading: arrive as the robot comes
            here = self._odometer.read()
            numbers.append(here.yaw_rad)
        self._zeros_due = 0
        return self._navigator.go_to(numbers[0], numbers[1], numbers[2], self.progress)

    @override
    def follow(self, speed_m_s: float, turn_rate_rad_s: float, timeout_s: float) -> Activity:
        end_s = self._clock.now() + timeout_s
        self._zeros_due = 0
        while (left_s := end_s - self._clock.now()) > 0:
            self._send(speed_m_s, turn_rate_rad_s)
            yield min(left_s, _PERIOD_S)
        self.halt()
        return 1

    @override
    def drive(self, distance_m: float, speed_m_s: float) -> Activity:
        begin = self._odometer.read()
        course = math.cos(begin.yaw_rad), math.sin(begin.yaw_rad)

        def gone_m(now: RosOdometryReading) -> float:
            return (now.x_m - begin.x_m) * course[0] + (now.y_m - begin.y_m) * course[1]

        def send(speed: float) -> None:
            turned_rad = self._odometer.read().yaw_rad - begin.yaw_rad
            self._send(speed, -2.0 * turned_rad)  # hold the heading

        return self._move(distance_m, speed_m_s, self.drivetrain.acceleration_m_s2, 0.002, gone_m, send)

    @override
    def turn(self, angle_rad: float, turn_rate_rad_s: float) -> Activity:
        begin = self._odometer.read()
        acceleration_rad_s2 = 2.0 * self.drivetrain.acceleration_m_s2 / self.drivetrain.track_m
        return self._move(
            angle_rad,
            turn_rate_rad_s,
            acceleration_rad_s2,
            0.005,
            lambda now: now.yaw_rad - begin.yaw_rad,
            lambda rate: self._send(0.0, rate),
        )

    def _move(
        self,
        length: float,
        speed: float,
        acceleration: float,
        tolerance: float,
        gone: Callable[[RosOdometryReading], float],
        send: Callable[[float], None],
    ) -> Activity:
        """Run a motion from rest to rest by the odometry; metres, or radians."""
        self._zeros_due = 0
        sign = math.copysign(1.0, length)
        is_over = False
        try:
            for now in self._watched(gone):
                left = abs(length) - sign * gone(now)
                if left <= tolerance:
                    is_over = True
                    break
                wanted = min(speed, math.sqrt(2.0 * acceleration * left) * 0.8)
                send(sign * max(wanted, _CREEP * speed))
                self.progress(1.0 - left / abs(length))
                yield _PERIOD_S
        finally:
            self.halt()
        end_s = self._clock.now() + _SETTLE_S
        while is_over and not self._odometer.read().is_still and self._clock.now() < end_s:
            yield _PERIOD_S
        return 1

    def _watched(self, gone: Callable[[RosOdometryReading], float]) -> Iterator[RosOdometryReading]:
        """Return the newest odometry again and again; raises when it shows no motion for long, or is too old."""
        moved_s, furthest = self._clock.now(), -math.inf
        while True:
            now = self._odometer.read()
            if abs(gone(now)) > furthest + 1e-3:
                moved_s, furthest = self._clock.now(), abs(gone(now))
            elif self._clock.now() - moved_s > _STUCK_S:
                raise ResourceFaultError(f"halted: it was driven, but its odometry shows no motion in {_STUCK_S:g} s")
            yield now

    def _send_zero(self) -> None:
        try:
            self._send(0.0, 0.0)
        except UnavailableError:  # repeated until the link is back
            return
        self._zeros_due = max(0, self._zeros_due - 1)

    def _send(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        twist = {"linear": {"x": speed_m_s}, "angular": {"z": turn_rate_rad_s}}
        if self._stamped:
            sec, nanosec = divmod(time.time_ns(), 1_000_000_000)
            self._publisher.publish({"header": {"stamp": {"sec": sec, "nanosec": nanosec}}, "twist": twist})
        else:
            self._publisher.publish(twist)
