"""The commands that drive a base to places in the map frame."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

from eal_actors.device.data import DataType, EALData
from eal_actors.device.info import ValueInfo
from eal_actors.device.localization.pose_estimate import Point
from eal_actors.device.motion.closed_loop import ClosedLoop, MotionDevice
from eal_actors.device.motion.route import Route
from eal_actors.device.motion.route_controller import MotionLimits, RouteController
from eal_actors.device.resource import Activity, Resource, command, request, setting
from eal_actors.kernel.errors import ArgumentError, UnsupportedError

if TYPE_CHECKING:
    from eal_actors.device.plugin_context import PluginContext

BLOCKED: Final = 2
"""The status of a base that is driven, but held by something."""

MAX_WAYPOINTS: Final = 10_000
"""Waypoints of a path. A base answers nothing while it makes a route: ten thousand points take 30 ms, half a million
took seconds, in which it could not be stopped."""
_MOST_YAW_RAD: Final = 4 * math.pi  # two turns; a heading in degrees is mostly more
_TAKES_S: Final = 110.0
"""Allowed for the way, whose length is not known before it begins."""
MAX_PLACE_M: Final = 1e6
"""Greatest coordinate of a place; beyond, the motion of a step is lost in the rounding."""

GOAL: Final = ValueInfo(DataType.DOUBLE, "m", shape=(None,), description="x_m, y_m and perhaps yaw_rad, in the map")
"""The argument of `goto`, by which a check before a run knows the command."""
_PATH: Final = ValueInfo(DataType.DOUBLE, "m", shape=(None, 2), description="waypoints x_m, y_m, in the map")
_POSES: Final = ValueInfo(
    DataType.DOUBLE, shape=(None, 3), description="x_m, y_m, yaw_rad in the map, from where the motion began to its end"
)
_UNCERTAINTY: Final = ValueInfo(DataType.DOUBLE, "m", 0.01, 100)


class MapMotions(Resource, ABC):
    """Drives to a place and along a path, guided by the robot's estimated pose; a part of DifferentialBase.

    Without a context, the driver estimates no pose.
    """

    max_uncertainty_m: float = setting(
        _UNCERTAINTY, "Greatest standard deviation of the position with which it drives to a place."
    )

    def __init__(self, context: PluginContext | None) -> None:
        self._context = context
        self.max_uncertainty_m = 0.3
        self._path: list[float] = []

    @abstractmethod
    def follow(self, speed_m_s: float, turn_rate_rad_s: float, timeout_s: float) -> Activity:
        """Hold a twist, ahead and to the left positive, within the drivetrain's limits, until the time-out; then stop.

        Closing the activity leaves the wheels turning: a newer twist replaces it without a stop, a halt stops.
        """

    @abstractmethod
    def motion_limits(self) -> MotionLimits:
        """Return the limits of a motion that begins now."""

    def clearance_m(self, *, forward: bool) -> float:  # noqa: ARG002  # to be overridden
        """Return the free distance ahead, or behind, of the outline in m, as the sensors see it; 0 at a contact.

        Motions to a place stop before it. The default, infinity, is for a robot without such sensors.
        """
        return math.inf

    def is_held(self) -> bool:
        """Return whether the wheels are driven, but something holds the robot. The default reads the status."""
        return self.get_status() == BLOCKED

    @command("goto", GOAL, repeatable=True, takes_s=_TAKES_S)
    def go_to(self, goal: Any) -> Activity:
        """Drive to a place in the map frame; with a third number, turn to that heading there.

        Raises:
            ArgumentError: the goal is no [x_m, y_m] or [x_m, y_m, yaw_rad] of finite numbers, or too far away.
            UnsupportedError: the driver estimates no pose.
        """
        x_m, y_m, yaw_rad = self.goal_numbers(goal)
        return self._drive([(x_m, y_m)], yaw_rad)

    @staticmethod
    def goal_numbers(goal: Any) -> tuple[float, float, float | None]:
        """Return x, y and yaw of a goal; None for any heading.

        Raises ArgumentError if the goal is no [x_m, y_m] or [x_m, y_m, yaw_rad] of finite numbers, or the heading is
        more than two turns.
        """
        numbers = [float(number) for number in goal]
        if len(numbers) not in (2, 3) or not all(map(math.isfinite, numbers)):
            raise ArgumentError(f"goto needs finite numbers x_m, y_m and perhaps yaw_rad, not {numbers}")
        if len(numbers) > 2 and abs(numbers[2]) > _MOST_YAW_RAD:
            raise ArgumentError(f"goto takes its heading in radians, not {numbers[2]:g}; `go_to` takes degrees")
        return numbers[0], numbers[1], numbers[2] if len(numbers) > 2 else None

    @command("follow", _PATH, repeatable=True, takes_s=_TAKES_S)
    def follow_path(self, path: Any) -> Activity:
        """Drive along waypoints in the map frame to the last one; it turns in place at corners.

        Raises:
            ArgumentError: there are none or too many waypoints, a number is not finite, or a place is too far away.
            UnsupportedError: the driver estimates no pose.
        """
        return self._drive(self.path_points(path), None)

    @staticmethod
    def path_points(path: Any) -> list[Point]:
        """Return the waypoints of a path; ArgumentError if there are none or too many, or a number is not finite."""
        count = len(path) // 2 if isinstance(path, list | tuple) else len(path)
        if count > MAX_WAYPOINTS:
            raise ArgumentError(f"follow takes at most {MAX_WAYPOINTS:,} waypoints, not {count:,}")
        numbers = path if isinstance(path, list | tuple) else path.ravel().tolist()
        points = [(float(x_m), float(y_m)) for x_m, y_m in zip(numbers[::2], numbers[1::2], strict=True)]
        if not points or not all(math.isfinite(number) for point in points for number in point):
            raise ArgumentError("follow needs at least one waypoint of finite numbers x_m, y_m")
        return points

    @request("path", _POSES)
    def path(self) -> EALData:
        """Return the poses along the running motion to a place or along waypoints; none if there is no such motion."""
        return EALData(DataType.DOUBLE, self._path, is_ptr=True, frame_id="map")

    def along(self, points: Sequence[Point], yaw_rad: float | None, motion: Activity) -> Activity:
        """Return a motion whose path the request `path` answers while it runs.

        `points` are where it begins, its waypoints and its end, in the map. `yaw_rad` is the heading at its end, None
        for that of its arrival.
        """
        yaws = [math.atan2(y_m - from_y_m, x_m - from_x_m) for (from_x_m, from_y_m), (x_m, y_m) in pairwise(points)]
        yaws.append(yaw_rad if yaw_rad is not None else yaws[-1])
        self._path = [number for (x_m, y_m), yaw in zip(points, yaws, strict=True) for number in (x_m, y_m, yaw)]
        try:
            return (yield from motion)
        finally:
            self._path = []

    def _drive(self, points: list[Point], yaw_rad: float | None) -> Activity:
        if self._context is None:
            raise UnsupportedError("the driver of this base estimates no pose, so it cannot drive to a place")
        for x_m, y_m in points:
            if max(abs(x_m), abs(y_m)) > MAX_PLACE_M:
                raise ArgumentError(f"the place {x_m:g}, {y_m:g} is over {MAX_PLACE_M:g} m from the map's origin")
        clock, localizer, limits = self._context.clock, self._context.localizer, self.motion_limits()
        here = localizer.estimate(clock.now())
        path = [(here.x_m, here.y_m), *points]
        controller = RouteController(Route(path), yaw_rad, limits)
        device = MotionDevice(
            clock=clock,
            estimate=localizer.estimate,
            hold=self.follow,
            clearance_m=lambda forward: self.clearance_m(forward=forward),
            is_held=self.is_held,
            halt=self.halt,
            report=self.progress,
        )
        return self.along(path, yaw_rad, ClosedLoop(device, controller, limits, self.max_uncertainty_m).run())
