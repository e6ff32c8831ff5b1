"""A base that is driven by velocities and measured by odometry: its motions are closed here.

`follow` and every motion end by a velocity of zero. A halt that the link cannot carry is repeated until
the link is back.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Iterator
from typing import Final, Protocol

from typing_extensions import override

from eal_actors.device.differential_base import DifferentialBase, Drivetrain
from eal_actors.device.plugin_context import PluginContext
from eal_actors.device.resource import Activity
from eal_actors.kernel.errors import ResourceFaultError, UnavailableError

_PERIOD_S: Final = 0.05
_STUCK_S: Final = 3.0  # seconds of a motion without any progress by the odometry after which it is given up
_SETTLE_S: Final = 1.0
_CREEP: Final = 0.1  # the least share of the usual speed, near the end of a motion
_REPEATS: Final = 3  # velocities of zero after a halt: one may be dropped at a full link


class OdometryReading(Protocol):
    """Where a robot is by its odometry, in m and rad; the yaw counts turns."""

    @property
    def x_m(self) -> float:
        """Position."""

    @property
    def y_m(self) -> float:
        """Position."""

    @property
    def yaw_rad(self) -> float:
        """Heading."""

    @property
    def is_still(self) -> bool:
        """Whether the robot stands."""


class VelocityBase(DifferentialBase):
    """Drives a robot by velocities; get_status: 0 stands, 1 moves."""

    def __init__(self, drivetrain: Drivetrain, context: PluginContext) -> None:
        super().__init__(drivetrain, context)
        self._clock = context.clock
        self._zeros_due = 0

    @abstractmethod
    def read_odometry(self) -> OdometryReading:
        """Return the newest odometry. Raises UnavailableError if it is too old."""

    @abstractmethod
    def send_velocity(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """Send one velocity. Raises UnavailableError if the link is down."""

    def get_status(self) -> int:
        """Return 0 while it stands, 1 while it moves."""
        return 0 if self.read_odometry().is_still else 1

    @override
    def halt(self) -> None:
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
    def follow(self, speed_m_s: float, turn_rate_rad_s: float, timeout_s: float) -> Activity:
        end_s = self._clock.now() + timeout_s
        self._zeros_due = 0
        while (left_s := end_s - self._clock.now()) > 0:
            self.send_velocity(speed_m_s, turn_rate_rad_s)
            yield min(left_s, _PERIOD_S)
        self.halt()
        return 1

    @override
    def drive(self, distance_m: float, speed_m_s: float) -> Activity:
        begin = self.read_odometry()
        course = math.cos(begin.yaw_rad), math.sin(begin.yaw_rad)

        def gone_m(now: OdometryReading) -> float:
            return (now.x_m - begin.x_m) * course[0] + (now.y_m - begin.y_m) * course[1]

        def send(speed: float) -> None:
            turned_rad = self.read_odometry().yaw_rad - begin.yaw_rad
            self.send_velocity(speed, -2.0 * turned_rad)  # hold the heading

        return self._move(distance_m, speed_m_s, self.drivetrain.acceleration_m_s2, 0.002, gone_m, send)

    @override
    def turn(self, angle_rad: float, turn_rate_rad_s: float) -> Activity:
        begin = self.read_odometry()
        acceleration_rad_s2 = 2.0 * self.drivetrain.acceleration_m_s2 / self.drivetrain.track_m
        return self._move(
            angle_rad,
            turn_rate_rad_s,
            acceleration_rad_s2,
            0.005,
            lambda now: now.yaw_rad - begin.yaw_rad,
            lambda rate: self.send_velocity(0.0, rate),
        )

    def _move(
        self,
        length: float,
        speed: float,
        acceleration: float,
        tolerance: float,
        gone: Callable[[OdometryReading], float],
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
        while is_over and not self.read_odometry().is_still and self._clock.now() < end_s:
            yield _PERIOD_S
        return 1

    def _watched(self, gone: Callable[[OdometryReading], float]) -> Iterator[OdometryReading]:
        """Return the newest odometry again and again; raises when it shows no motion for long, or is too old."""
        moved_s, furthest = self._clock.now(), -math.inf
        while True:
            now = self.read_odometry()
            if abs(gone(now)) > furthest + 1e-3:
                moved_s, furthest = self._clock.now(), abs(gone(now))
            elif self._clock.now() - moved_s > _STUCK_S:
                raise ResourceFaultError(f"halted: it was driven, but its odometry shows no motion in {_STUCK_S:g} s")
            yield now

    def _send_zero(self) -> None:
        try:
            self.send_velocity(0.0, 0.0)
        except UnavailableError:  # repeated until the link is back
            return
        self._zeros_due = max(0, self._zeros_due - 1)
