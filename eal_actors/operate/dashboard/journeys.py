"""Journeys: sends robots from the page's map to points of the floor, along planned paths that every page shows."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.facade.traffic.positions import radius_m_of
from eal_actors.kernel.errors import UnsupportedError
from eal_actors.operate.dashboard.control import DashboardContext
from eal_actors.operate.dashboard.messages import SendRobot
from eal_actors.operate.dashboard.teleop import DRIVE_RESOURCE

Path = Sequence[tuple[float, float]]


class Journeys:
    """The journeys of a fleet's robots; the store's kind `paths` has the path of each that is under way.

    Thread: any.
    """

    def __init__(self, context: DashboardContext) -> None:
        self._fleet, self._store, _, self._control = context
        self._lock = threading.Lock()
        self._current: dict[str, object] = {}

    def send(self, message: SendRobot, browser: str, on_end: Callable[[BaseException | None], None]) -> None:
        """Plan a path from where a robot is, and start it. `on_end` is called at its end, with the error if it failed.

        Raises:
            RobotNotFoundError: the fleet has no such robot.
            ResourceNotFoundError: it has no base or no pose.
            NoPathError: no path leads to the point.
            EALError: its pose is not known.

        Thread: blocks the caller for the answer of the robot and for the plan.
        """
        robot = self._fleet[message.robot]
        path = self._plan(robot, message)
        self._control.acquire(robot.name, DRIVE_RESOURCE, browser)
        try:
            journey = robot.base.follow(path[1:])
        except BaseException:
            self._control.done(robot.name, DRIVE_RESOURCE)
            raise
        with self._lock:
            self._current[robot.name] = journey
            self._store.put("paths", {robot.name: [[round(x, 3), round(y, 3)] for x, y in path]})
        journey.add_done_callback(lambda done: self._on_done(robot.name, done, on_end))

    def _plan(self, robot: RobotHandle, message: SendRobot) -> Path:
        here = robot.pose.get().get()
        start, goal = (here.x_m, here.y_m), (message.x_m, message.y_m)
        from eal_actors.device.navigation.floor import WALL_MARGIN_M, floor_grid
        from eal_actors.device.navigation.planner import plan_path

        floor = floor_grid(self._fleet.config.world, self._fleet.config.map_path, message.keep_out)
        if floor is None:
            if message.keep_out:
                raise UnsupportedError("keep-out zones need a world or a map; without one, robots drive straight")
            return start, goal
        return plan_path(floor.inflated(radius_m_of(robot) + WALL_MARGIN_M), start, goal).points_m

    def _on_done(self, robot: str, done: Future[int], on_end: Callable[[BaseException | None], None]) -> None:
        self._control.done(robot, DRIVE_RESOURCE)
        with self._lock:
            if self._current.get(robot) is done:  # else a newer journey replaced it
                del self._current[robot]
                self._store.put("paths", {robot: None})
        on_end(done.exception())
