"""The part of a fleet that brings its robots to places."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.many import by_robot, read_many
from eal_actors.facade.traffic.trips import Journey, TripGoal
from eal_actors.kernel.errors import ArgumentError

if TYPE_CHECKING:
    from eal_actors.device.world import NamedPlace
    from eal_actors.facade.traffic.control import TrafficControl
    from eal_actors.kernel.clock import Clock
    from eal_actors.managers.fleet_model import FleetConfig

Place: TypeAlias = str | Sequence[float]
"""The name of a place in the world file, or x_m and y_m, or x_m, y_m and yaw_deg."""

JOURNEY_TIMEOUT_S: Final = 600.0
"""The default deadline of a journey, in seconds of the fleet's clock."""


class TravellingRobots:
    """Robots that travel together; a part of Fleet."""

    clock: Clock
    config: FleetConfig

    def __init__(self) -> None:
        self._traffic: TrafficControl | None = None
        self._traffic_lock = threading.Lock()

    if TYPE_CHECKING:

        def __getitem__(self, name: str) -> RobotHandle: ...

        def place(self, name: str) -> NamedPlace: ...  # noqa: D102  # as in Fleet

    def go_to(self, goals: Mapping[Any, Place], *, timeout_s: float = JOURNEY_TIMEOUT_S) -> Journey:
        """Bring robots to places, all at once, so that they neither collide nor block each other for ever.

            fleet.go_to({"evbot2-1": "dock", "roomba-1": (1.0, 0.5), "evbot3-1": (0.0, 0.5, 90)}).get()

        The paths of all are planned together on the fleet's world. Each robot enters a piece of floor when those that
        pass it before have left, so delays and stops never make a collision. Robots of the fleet that are not sent
        stand, and make way only where there is no plan otherwise. If one fails on its way, the others are planned anew
        round it, or it makes way for them; so they are when a newer `go_to` sends further robots, or sends one
        elsewhere, whose older trip fails with PreemptedError. `halt`, `stop` and `close` cancel all trips.

        Args:
            goals: by robot, or its name: the name of a place in the world file; or (x_m, y_m) in the map frame; or
                (x_m, y_m, yaw_deg).
            timeout_s: seconds of the fleet's clock until the journey's deadline.

        The journey is done when each robot has arrived or failed; its `arrivals` has a future for each robot. It fails
        with ArgumentError, before any robot moves, if there is no plan; the message names the robots and the reason. It
        fails with BlockedError if the only way of a robot stays closed.

        Raises:
            RobotNotFoundError: the fleet has no robot of a name.
            ResourceNotFoundError: a robot has no resource Base or Pose.
            PlaceNotFoundError: the world has no place of a name.
            ArgumentError: a robot is given twice, or a place is not as above.

        Thread: any; does not block.
        """
        trips = {}
        for robot, place in goals.items():
            handle = robot if isinstance(robot, RobotHandle) else self[robot]
            if handle in trips:
                raise ArgumentError(f"robot {handle.name!r} is given twice")
            for part in ("Base", "Pose"):
                _ = handle[part]
            trips[handle] = self._goal_of(place, f"the goal of {handle.name}")
        if not timeout_s > 0:
            raise ArgumentError(f"timeout_s must be over 0 s, not {timeout_s!r}")
        return self._traffic_control().start(trips, timeout_s)

    def visit(
        self, robot: RobotHandle | str, places: Iterable[Place], *, timeout_s: float = JOURNEY_TIMEOUT_S
    ) -> Iterator[Place]:
        """Bring a robot to places one after another; yield each when the robot is there.

            for place in fleet.visit("evbot3-1", ["shelf", "dock"]):
                print(place, fleet["evbot3-1"].camera.frame().get().shape)

        `robot` may be its name; `places` are as for `go_to`, or the name of one. `timeout_s` is in seconds of the
        fleet's clock, to each of them. Raises EALError as for `go_to`. Thread: any; blocks the caller.
        """
        for place in [places] if isinstance(places, str) else places:  # not its letters
            self.go_to({robot: place}, timeout_s=timeout_s).get()
            yield place

    def form(
        self,
        robots: Iterable[RobotHandle | str],
        shape: str,
        *,
        spacing_m: float,
        at: Place = (0.0, 0.0, 0.0),
        timeout_s: float = JOURNEY_TIMEOUT_S,
    ) -> Journey:
        """Let robots take up the places of a shape, with a short way for each.

            fleet.form(fleet.select(tags=["tracked"]), "wedge", spacing_m=1.0, at="dock").get()

        Args:
            robots: the robots or their names, each once.
            shape: line, column, grid, circle or wedge.
            spacing_m: distance between neighbours.
            at: the centre, as for `go_to`; the shape faces its heading.
            timeout_s: as for `go_to`.

        Raises:
            EALError: as for `go_to`, or a robot's pose cannot be read.
            ArgumentError: a robot is given twice, there is no such shape, or a number is out of its range.

        Thread: any; blocks the caller until the poses of the robots are known.
        """
        from eal_actors.facade.traffic.formations import formation_goals  # pydantic and the world are slow to import

        resources = [robot["Pose"] for robot in self._chosen(robots)]
        poses = by_robot(resources, read_many(resources)).get()
        starts = {name: (float(pose.value[0]), float(pose.value[1])) for name, pose in poses.items()}
        return self.go_to(formation_goals(starts, shape, spacing_m, self.pose_at(at)), timeout_s=timeout_s)

    def _chosen(self, robots: Iterable[RobotHandle | str]) -> list[RobotHandle]:
        """Return the handles of robots or names; raise ArgumentError if one is given twice."""
        chosen = [robots] if isinstance(robots, str | RobotHandle) else robots  # not its letters or resources
        handles = [self[robot] if isinstance(robot, str) else robot for robot in chosen]
        if len(set(handles)) != len(handles):
            raise ArgumentError(f"a robot is given twice: {', '.join(robot.name for robot in handles)}")
        return handles

    def pose_at(self, place: Place) -> tuple[float, float, float]:
        """Return x_m, y_m and yaw_deg of a place; the heading is 0 if the place has none.

        Raises:
            PlaceNotFoundError: the world has no place of the name.
            ArgumentError: it is no place.
        """
        goal = self._goal_of(place, "the place")
        return (*goal.point, goal.yaw_deg or 0.0)

    def _goal_of(self, place: Place, what: str) -> TripGoal:
        if not isinstance(place, str):
            return goal_of(place, what)
        named = self.place(place)
        return TripGoal((named.x_m, named.y_m), named.yaw_deg)

    def _traffic_control(self) -> TrafficControl:
        from eal_actors.device.navigation.floor import floor_grid
        from eal_actors.facade.traffic.control import TrafficControl  # it needs numpy, which small boards do without

        with self._traffic_lock:
            if self._traffic is None:
                robots = self if isinstance(self, Mapping) else {}
                floor = floor_grid(self.config.world, self.config.map_path)
                self._traffic = TrafficControl(robots, self.clock, floor, self.config.seed)
            return self._traffic

    def _cancel_trips(self) -> None:
        if self._traffic is not None:
            self._traffic.cancel()

    def _end_traffic(self, timeout_s: float) -> None:
        if self._traffic is not None:
            self._traffic.close(timeout_s)


def goal_of(place: Sequence[float], what: str) -> TripGoal:
    """Return the goal at a position, perhaps with a heading; ArgumentError if it is not two or three finite numbers."""
    try:
        numbers = [float(number) for number in place]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) not in {2, 3} or not all(map(math.isfinite, numbers)):
        raise ArgumentError(f"{what} must be the name of a place, (x_m, y_m) or (x_m, y_m, yaw_deg), not {place!r}")
    return TripGoal((numbers[0], numbers[1]), numbers[2] if len(numbers) == 3 else None)
