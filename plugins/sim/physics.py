"""Contact: which robots may touch something, the physics of those that push and slide, and the gaps to an observer.

A robot with nothing in its way needs no physics engine: its path is known exactly. Only a robot that runs into
something gets a body in the engine, for as long as it pushes. So free robots are cheap, their paths are exact and
independent of other robots, and contacts can be stepped finely.

Thread: every member of the classes is for the holder of the world's lock.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np
import pymunk

from eal_actors.device.proximity import ProximityObserver
from eal_actors.device.world import WorldModel

from .arena import Pose2D, QuerySpace, add_solids, distances_to_drops_m
from .boxes import SimBox
from .free_robots import FreeRobots
from .models import MAKES, Make
from .robot import SimRobot

if TYPE_CHECKING:
    from numpy.typing import NDArray

_Part: TypeAlias = pymunk.Body | pymunk.Shape | pymunk.Constraint

_SUBSTEPS: Final = 10
"""Engine steps in a tick: a robot that runs into a wall sinks in by its travel in one of them."""

_SLOP_M: Final = 0.0005  # how far shapes may overlap before they are pushed apart
_ROBOT_FRICTION: Final = 0.3
_FREE_M: Final = 1e-9  # rounding: a robot that the engine moved as predicted touched nothing
_SEARCH_M: Final = 2.0  # search radius around a robot
_RECEDES_M: Final = 1e-9  # an approach by less than this is no contact
_ROWS: Final = 32  # of a table of distances, computed at once: more would not fit a processor's cache
_ERRORS: Final = 1.2  # a robot's true speed over its make's greatest, at most: with wheel errors and pushed boxes
_FASTEST_M_S: Final = _ERRORS * max(make.max_speed_m_s for make in MAKES.values())


class _PushingBody:
    """A robot's body in the engine, dragged by a control body through two joints of limited force.

    The control body has the velocity that the wheels give. The joints pass it on with at most the robot's push force,
    so that a wall stops the robot.
    """

    def __init__(self, robot: SimRobot, space: pymunk.Space) -> None:
        make = robot.make
        moment = pymunk.moment_for_circle(make.mass_kg, 0.0, make.radius_m)
        self.body = pymunk.Body(make.mass_kg, moment)
        self._control = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        for body in (self.body, self._control):
            body.position, body.angle = robot.pose[:2], robot.pose[2]
        pivot = pymunk.PivotJoint(self._control, self.body, (0.0, 0.0), (0.0, 0.0))
        gear = pymunk.GearJoint(self._control, self.body, 0.0, 1.0)
        pivot.max_bias = gear.max_bias = 0.0  # the wheels do not make up for travel lost at a wall
        pivot.max_force = make.push_n
        gear.max_force = make.push_n * make.track_m / 2
        self.disc = _disc(robot, self.body)
        self.parts: list[_Part] = [self._control, self.body, self.disc, pivot, gear]
        space.add(*self.parts)
        self.command(robot)
        self.body.velocity, self.body.angular_velocity = self._control.velocity, self._control.angular_velocity

    def command(self, robot: SimRobot) -> None:
        """Set the control body's velocity, so that it reaches the predicted pose in one tick."""
        (x_m, y_m, yaw_rad), (next_x_m, next_y_m, next_yaw_rad) = robot.pose, robot.next_pose
        self._control.velocity = (next_x_m - x_m) / robot.tick_s, (next_y_m - y_m) / robot.tick_s
        self._control.angular_velocity = (next_yaw_rad - yaw_rad) / robot.tick_s

    def pose_after(self, robot: SimRobot) -> Pose2D:
        """Return the pose after the tick; the predicted pose object itself if nothing was in its way."""
        pose = (*self.body.position, self.body.angle)
        free = all(abs(one - other) < _FREE_M for one, other in zip(pose, robot.next_pose, strict=True))
        return robot.next_pose if free else pose


class ContactEngine:
    """The physics engine: standing robots, sliding boxes and pushing robots.

    Args:
        on_contact: called with the name of a robot and that of what it begins to touch.

    Attributes:
        space: the engine's space; queried only to decide which robots push.
    """

    def __init__(
        self, model: WorldModel, tick_s: float, on_contact: Callable[[str, str], object] = lambda *_: None
    ) -> None:
        self._tick_s = tick_s
        self._on_contact = on_contact
        self.space = pymunk.Space()
        self.space.collision_slop = _SLOP_M
        self.space.on_collision(begin=self._report_contact)
        self._names = add_solids(self.space, model)
        self.boxes = tuple(SimBox(model, number, self.space) for number in range(len(model.boxes)))
        self._names.update({box.shape: f"box {box.name}" for box in self.boxes})
        self._discs: dict[pymunk.Shape, str] = {}
        self._standing: dict[SimRobot, list[_Part]] = {}
        self._pushing: dict[SimRobot, _PushingBody] = {}

    @property
    def is_awake(self) -> bool:
        """Whether anything in it may move in the next tick."""
        return bool(self._pushing) or any(box.is_moving for box in self.boxes)

    def _report_contact(self, arbiter: pymunk.Arbiter, _space: pymunk.Space, _data: object) -> None:
        """Report a contact that begins in a step of the engine, if a robot is part of it."""
        for one, other in (arbiter.shapes, reversed(arbiter.shapes)):
            if (robot := self._discs.get(one)) is not None:
                self._on_contact(robot, self._discs.get(other) or self._names.get(other, "something"))
                return

    def settle(self, robot: SimRobot) -> None:
        """Make a robot stand: nothing moves it, not even a rounding error."""
        self.release(robot)
        body = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        body.position = robot.pose[:2]
        disc = _disc(robot, body)
        parts: list[_Part] = [body, disc]
        self.space.add(*parts)
        self._standing[robot] = parts
        self._discs[disc] = robot.name

    def release(self, robot: SimRobot) -> None:
        """Take a robot out of the engine: it drives freely."""
        removed = self._standing.pop(robot, [])
        if body := self._pushing.pop(robot, None):
            removed = [*removed, *body.parts]
        if removed:
            self.space.remove(*removed)
        for part in removed:
            if isinstance(part, pymunk.Shape):
                del self._discs[part]

    def run_tick(self, pushing: Iterable[SimRobot]) -> dict[SimRobot, Pose2D]:
        """Step the engine by one tick; return the poses of the pushing robots after it."""
        now_pushing = dict.fromkeys(pushing)
        for robot in [robot for robot in self._pushing if robot not in now_pushing]:
            self.release(robot)
        for robot in now_pushing:
            if body := self._pushing.get(robot):
                body.command(robot)
            else:
                self._pushing[robot] = body = _PushingBody(robot, self.space)
                self._discs[body.disc] = robot.name
        if not self.is_awake:
            return {}
        for _ in range(_SUBSTEPS):
            self.space.step(self._tick_s / _SUBSTEPS)
        for box in self.boxes:
            if not box.is_moving:
                box.rest()
        return {robot: body.pose_after(robot) for robot, body in self._pushing.items()}


class ContactSearch:
    """Finds the robots that would overlap something at the end of a tick, and come closer to it in the tick.

    After a search, a robot is skipped until it or anything else could have covered the distance found.

    Args:
        engine: holds everything that stands, slides or pushes.
    """

    def __init__(self, engine: ContactEngine, tick_s: float) -> None:
        self._engine = engine
        self._tick_s = tick_s
        self._tick_m = self._widest_m = 0.0

    def expect(self, make: Make) -> None:
        """Expect robots of a make. How long others stay clear must be found anew."""
        self._tick_m = max(self._tick_m, _ERRORS * make.max_speed_m_s * self._tick_s)
        self._widest_m = max(self._widest_m, make.radius_m)

    def search(self, driven: Sequence[SimRobot], together: FreeRobots[SimRobot], tick: int, end: int) -> None:
        """Find out how long robots stay clear of everything, unless that is known up to the tick `end`.

        `together` has some of the driven robots.
        """
        due = [robot for robot in driven if robot.clear_until_tick < end]
        if due:
            alone = [robot for robot in driven if robot.free is None]
            numbers = {robot: number for number, robot in enumerate(alone)}
            places = np.array([robot.pose[:2] for robot in alone], np.float64).reshape(-1, 2)
            if together.robots:
                places = np.concatenate([places, together.places()])
            rows = [numbers[robot] if robot.free is None else len(alone) + together.column_of(robot) for robot in due]
            between_m = _nearest_m(places, rows)
            for robot, place, middle_m in zip(due, map(tuple, places[rows].tolist()), between_m, strict=True):
                self._note(robot, place, middle_m, tick)

    def find(
        self,
        driven: Sequence[SimRobot],
        tick: int,
        together: FreeRobots[SimRobot] | None = None,
        alone: Sequence[SimRobot] = (),
        ahead: int = 0,
    ) -> list[SimRobot]:
        """Return those of some driven robots that may touch something in this tick, in their order.

        The result includes robots that are near one of those: these may stop at an unexpected place. The poses of the
        driven robots are predicted. `together` and `alone` are free robots, which are `ahead` by some ticks; the former
        touch nothing.
        """
        due = [number for number, robot in enumerate(driven) if robot.clear_until_tick < tick]
        if not due:
            return []
        places = np.array([robot.next_pose[:2] for robot in driven] + [robot.pose[:2] for robot in alone])
        if together is not None and together.robots:
            places = np.concatenate([places, together.places()])
        between_m = _nearest_m(places, due)
        near = []
        for number, middle_m in zip(due, between_m, strict=True):
            robot = driven[number]
            if not self._note(robot, robot.next_pose[:2], middle_m - ahead * self._tick_m, tick):
                near.append(robot)
        return self._among(near) if near else []

    def _note(self, robot: SimRobot, place: tuple[float, ...], between_m: float, tick: int) -> bool:
        """Record how long a robot stays clear; return whether it is clear in this tick, in which it is at a place.

        `between_m` is the distance from its centre to the nearest centre of another driven robot.
        """
        reach_m = min(between_m - self._widest_m, _SEARCH_M)
        hit = self._engine.space.point_query_nearest(place, max(reach_m, 0.0), robot.filter)  # type: ignore[arg-type]
        gap_m = min(reach_m, hit.distance if hit else reach_m) - robot.make.radius_m
        is_clear = gap_m > 2 * self._tick_m
        if is_clear:
            robot.clear_until_tick = tick + int(gap_m / (2 * self._tick_m)) - 1
        return is_clear

    def _among(self, near: Sequence[SimRobot]) -> list[SimRobot]:
        """Return the robots that run into something or each other, and all that are close to one of them."""
        neighbours = _neighbours(near, 2 * self._tick_m)
        found = [
            number
            for number, robot in enumerate(near)
            if self._runs_into(robot) or any(_meet(robot, near[other]) for other in neighbours[number])
        ]
        pushing = set(found)
        while found:
            found = [other for number in found for other in neighbours[number] if other not in pushing]
            pushing.update(found)
        return [near[number] for number in sorted(pushing)]

    def _runs_into(self, robot: SimRobot) -> bool:
        """Return whether a robot runs into anything but a free robot."""
        radius_m = robot.make.radius_m
        for hit in self._engine.space.point_query(robot.next_pose[:2], radius_m + self._tick_m, robot.filter):
            body = hit.shape.body
            if body is None or body.velocity != (0.0, 0.0):  # it pushes, or slides
                return True
            now_m = hit.shape.point_query(robot.pose[:2]).distance
            if hit.distance < radius_m and hit.distance < now_m - _RECEDES_M:
                return True
        return False


class ProximityReporter:
    """Reports the gaps around robots to an observer.

    After a report, a robot is skipped until something may have come nearer than the gap that the observer asked for.

    Args:
        observer: receives the gaps.

    Attributes:
        is_stale: whether something was placed since the last report.
    """

    def __init__(self, model: WorldModel, queries: QuerySpace, observer: ProximityObserver, tick_s: float) -> None:
        self.is_stale = False
        self._model = model
        self._queries = queries
        self._observer = observer
        self._tick_s = tick_s
        self._closing_m = 2 * _FASTEST_M_S * tick_s
        self._due: dict[SimRobot, int] = {}

    def report(self, robots: Iterable[SimRobot], tick: int) -> None:
        """Report the gaps around the robots at the end of a tick."""
        if self.is_stale:
            self.is_stale = False
            self._due.clear()
        for robot in robots:
            if self._due.get(robot, 0) > tick:
                continue
            gaps_m = self._gaps_m(robot)
            wanted_m = self._observer.observe(tick * self._tick_s, robot.name, robot.pose[:2], gaps_m)
            spare_m = min(gaps_m.values(), default=self._observer.reach_m) - wanted_m
            self._due[robot] = tick + 1 + int(max(0.0, spare_m) / self._closing_m)

    def _gaps_m(self, robot: SimRobot) -> dict[str, float]:
        radius_m, reach_m = robot.make.radius_m, self._observer.reach_m
        hits = self._queries.space.point_query(robot.pose[:2], radius_m + reach_m, robot.filter)
        gaps_m = {self._queries.names[hit.shape]: hit.distance - radius_m for hit in hits}
        for number, distance_m in enumerate(distances_to_drops_m(self._model, *robot.pose[:2])):
            if distance_m < radius_m + reach_m:
                gaps_m[f"drops[{number}]"] = distance_m - radius_m
        return gaps_m


def _disc(robot: SimRobot, body: pymunk.Body) -> pymunk.Circle:
    disc = pymunk.Circle(body, robot.make.radius_m)
    disc.filter, disc.friction = robot.filter, _ROBOT_FRICTION
    return disc


def _neighbours(robots: Sequence[SimRobot], gap_m: float) -> list[list[int]]:
    """Return for each robot the indices of those within a gap."""
    places = np.array([robot.pose[:2] for robot in robots])
    radii_m = np.array([robot.make.radius_m for robot in robots])
    dx, dy = (places[:, axis, np.newaxis] - places[:, axis] for axis in range(2))
    reach_m = radii_m[:, np.newaxis] + radii_m + gap_m
    close = dx * dx + dy * dy < reach_m * reach_m
    np.fill_diagonal(close, val=False)
    found: list[list[int]] = [[] for _ in robots]
    for one, other in zip(*(numbers.tolist() for numbers in np.nonzero(close)), strict=True):
        found[one].append(other)
    return found


def _nearest_m(ends: NDArray[np.float64], due: list[int]) -> list[float]:
    """Return the distance of the ends of the due rows from the nearest other end."""
    xs, ys = np.ascontiguousarray(ends.T)
    nearest: list[float] = []
    for start in range(0, len(due), _ROWS):
        rows = due[start : start + _ROWS]
        square = np.subtract.outer(xs[rows], xs)
        square *= square
        dy = np.subtract.outer(ys[rows], ys)
        dy *= dy
        square += dy
        square[np.arange(len(rows)), rows] = np.inf
        nearest += np.sqrt(square.min(axis=1)).tolist()
    return nearest


def _meet(one: SimRobot, other: SimRobot) -> bool:
    if one.filter.group == other.filter.group:
        return False
    reach_m = one.make.radius_m + other.make.radius_m
    end_m = math.dist(one.next_pose[:2], other.next_pose[:2])
    return end_m < reach_m and end_m < math.dist(one.pose[:2], other.pose[:2]) - _RECEDES_M
