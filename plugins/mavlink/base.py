"""The base of a rover or copter: velocities, position set-points, and a geofence that is checked beforehand."""

from __future__ import annotations

import itertools
import math
from typing import Any, Final

from typing_extensions import override

from eal_actors.plugin import (
    Activity,
    ArgumentError,
    BlockedError,
    PluginContext,
    ResourceFaultError,
    VelocityBase,
    wrapped_rad,
)

from .autopilot import check_guided, make_guided
from .fence import Fence
from .link import MavLink, VehicleReading
from .protocol import guided_mode
from .settings import Settings

_PERIOD_S: Final = 0.1
_NEAR_M: Final = 0.12
_NEAR_RAD: Final = 0.1
_STUCK_S: Final = 10.0
_AHEAD_S: Final = 0.5
"""A velocity is refused that would leave the geofence within this time."""


class Base(VelocityBase):
    """Drives or flies the vehicle; get_status: 0 stands, 1 moves."""

    def __init__(self, context: PluginContext, link: MavLink) -> None:
        settings: Settings = context.settings
        super().__init__(settings.drivetrain(f"MAVLink {settings.vehicle}", track_m=2 * settings.radius_m), context)
        self._settings = settings
        self._link = link
        self._fence = None if settings.geofence is None else Fence(settings.geofence)

    @override
    def not_ready(self) -> str | None:
        if (problem := self._link.why_not_ready()) is not None or self._settings.auto_arm:
            return problem
        wanted = guided_mode(self._link.autopilot())
        if not self._link.is_armed():
            return "the vehicle is not armed: send `arm` to Autopilot"
        return None if self._link.mode() == wanted else f"the vehicle is in {self._link.mode()}, not in {wanted}"

    @override
    def read_odometry(self) -> VehicleReading:
        return self._link.reading()

    @override
    def send_velocity(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        if speed_m_s and self._fence is not None:
            here = self._link.reading()
            ahead_m = speed_m_s * _AHEAD_S
            end = here.x_m + ahead_m * math.cos(here.yaw_rad), here.y_m + ahead_m * math.sin(here.yaw_rad)
            if not self._fence.contains_way((here.x_m, here.y_m), end):
                self.halt()
                raise BlockedError(f"halted: the geofence is {abs(ahead_m):.2f} m away")
        self._link.send_velocity(speed_m_s, turn_rate_rad_s)

    @override
    def drive(self, distance_m: float, speed_m_s: float) -> Activity:
        here = self._link.reading()
        goal = here.x_m + distance_m * math.cos(here.yaw_rad), here.y_m + distance_m * math.sin(here.yaw_rad)
        self._check_way((here.x_m, here.y_m), goal)
        return self._guided(super().drive(distance_m, speed_m_s))

    @override
    def turn(self, angle_rad: float, turn_rate_rad_s: float) -> Activity:
        return self._guided(super().turn(angle_rad, turn_rate_rad_s))

    @override
    def follow(self, speed_m_s: float, turn_rate_rad_s: float, timeout_s: float) -> Activity:
        return self._guided(super().follow(speed_m_s, turn_rate_rad_s, timeout_s))

    @override
    def go_to(self, goal: Any) -> Activity:
        x_m, y_m, yaw_rad = self.goal_numbers(goal)
        here = self._link.reading()
        path = [(here.x_m, here.y_m), (x_m, y_m)]
        self._check_way(*path)
        return self._guided(self.along(path, yaw_rad, self._fly_to(x_m, y_m, yaw_rad)))

    @override
    def follow_path(self, path: Any) -> Activity:
        points = self.path_points(path)
        here = self._link.reading()
        path = [(here.x_m, here.y_m), *points]
        for start, end in itertools.pairwise(path):
            self._check_way(start, end)
        return self._guided(self.along(path, None, self._fly_along(points)))

    def _check_way(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        if self._fence is not None and not self._fence.contains_way(start, end):
            raise ArgumentError(f"the way to {end[0]:g}, {end[1]:g} leaves the geofence")

    def _guided(self, motion: Activity) -> Activity:
        """Arm and switch the mode first, if the settings allow it."""
        if self._settings.auto_arm:
            yield from make_guided(self._link, self._settings.vehicle)
        return (yield from motion)

    def _fly_along(self, points: list[tuple[float, float]]) -> Activity:
        for x_m, y_m in points:
            yield from self._fly_to(x_m, y_m, None)
        return 1

    def _fly_to(self, x_m: float, y_m: float, yaw_rad: float | None) -> Activity:
        """Send a place again and again until the vehicle stands there.

        A rover ignores the yaw of a place: it is turned at the end.
        """
        begin, is_rover = self._link.reading(), self._settings.vehicle == "rover"
        sent_rad, is_asked = None if is_rover else yaw_rad, False
        whole_m = math.dist((begin.x_m, begin.y_m), (x_m, y_m))
        nearest_m, nearer_s = math.inf, self._clock.now()
        try:
            while True:
                now = self._link.reading()
                left_m = math.dist((now.x_m, now.y_m), (x_m, y_m))
                is_turned = sent_rad is None or abs(wrapped_rad(now.yaw_rad - sent_rad)) < _NEAR_RAD
                if left_m < _NEAR_M and is_turned and now.is_still:
                    break
                if left_m < nearest_m - 0.01 or left_m < _NEAR_M:
                    nearest_m, nearer_s = min(left_m, nearest_m), self._clock.now()
                elif self._clock.now() - nearer_s > _STUCK_S:
                    raise ResourceFaultError(f"halted: it comes no nearer than {nearest_m:.2f} m in {_STUCK_S:g} s")
                check_guided(self._link)
                self._link.send_position(x_m, y_m, begin.altitude_m, sent_rad)
                if not is_asked:  # ArduPilot takes a speed for a place that it has
                    is_asked = True
                    self._link.request_speed(self.speed_m_s)
                self.progress(None if whole_m < _NEAR_M else 1.0 - left_m / whole_m)
                yield _PERIOD_S
        finally:
            self.halt()
        if is_rover and yaw_rad is not None and abs(turn_rad := wrapped_rad(yaw_rad - now.yaw_rad)) > _NEAR_RAD:
            yield from super().turn(turn_rad, math.radians(self.turn_rate_deg_s))
        return 1
