"""The world that all simulated robots of a fleet share."""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Callable
from itertools import count, repeat
from typing import Final, TypeAlias

import pymunk

from eal_actors.device.proximity import Contact, ProximityObserver
from eal_actors.device.world import WorldModel
from eal_actors.plugin import ArgumentError, Clock, FleetServices, PluginError, UnavailableError, WheelCalibration

from .arena import Pose2D, QuerySpace, is_inside, is_on_floor, places
from .boxes import SimBox
from .free_robots import LEAST_WORK, MOST_TICKS, FreeRobots
from .models import Make
from .motion import NOMINAL, WheelMotion
from .physics import ContactEngine, ContactSearch, ProximityReporter
from .robot import SimRobot
from .velocity_drive import VelocityDrive

__all__ = ["EMPTY_ROOM", "SimBox", "SimWorld", "world_of"]

_SAME_S: Final = 1.0
"""Time within which a repeated contact counts as the same one."""
_MAX_CONTACTS: Final = 1000

EMPTY_ROOM: Final = WorldModel(version=1, name="empty-room", size_m=(6.0, 4.0))

TickCallback: TypeAlias = Callable[[float], bool]
"""Receives the world's time; returns whether to call it again at the next tick."""

_TICKS_AT_ONCE: Final = min(10, MOST_TICKS)
_ROUNDING: Final = 1e-6  # in ticks: a sum of times that falls short of a tick by less counts as the tick


class SimWorld:
    """Walls, obstacles, boxes and robots in one room.

    The world has no thread. It is stepped lazily: the holder of its lock calls `catch_up`, which runs the physics ticks
    that are due by the fleet's clock. While no robot is driven and no box slides, nothing can move, and due ticks are
    skipped.

    A robot's path depends only on the fleet's seed, the robot's name and its motions, as long as robots do not touch
    each other: a motion lasts whole ticks, whatever thread steps the world and however often.

    Args:
        model: size, obstacles and tick rate; None for an empty room.
        observer: receives the gaps around the robots; None for no reports.

    Attributes:
        lock: guards all of the world. Take it by `with world.lock`, and call `catch_up` inside. A method that
            takes it and returns would lose it to an AbandonedThread or KeyboardInterrupt before the block begins.
        version: increases whenever a robot or a box may have another pose. Thread: holds `lock`.

    Thread: any; one lock.
    """

    def __init__(
        self,
        clock: Clock,
        seed: int = 0,
        model: WorldModel | None = None,
        observer: ProximityObserver | None = None,
        contacts: list[Contact] | None = None,
        is_solid: bool = True,
    ) -> None:
        self.model: Final = model or EMPTY_ROOM
        self.is_solid: Final = is_solid
        self._clock = clock
        self._seed = seed
        self.lock: Final = threading.Lock()
        self._rate_hz = self.model.physics.rate_hz
        self.tick_s: Final = 1.0 / self._rate_hz
        self.version = 0
        self._tick = 0
        self._robots: dict[str, SimRobot] = {}
        self._placed: tuple[SimRobot, ...] = ()
        self._waiting: list[SimRobot] = []
        self._without_start: set[SimRobot] = set()
        self._driven: list[SimRobot] = []
        self._free: FreeRobots[SimRobot] = FreeRobots(self.tick_s)
        self._tick_callbacks: list[TickCallback] = []
        self._groups = count(1) if is_solid else repeat(1)  # in one group they do not meet
        self.contacts: Final[list[Contact]] = [] if contacts is None else contacts
        self._touched_s: dict[frozenset[str], float] = {}  # when each pair has touched the last time
        self._engine = ContactEngine(self.model, self.tick_s, self._note_contact)
        self._contacts = ContactSearch(self._engine, self.tick_s)
        self._queries = QuerySpace(self.model)
        for box in self._engine.boxes:
            self._queries.add_box(box, f"box {box.name}", box.model.size_m)
        self._proximity = (
            ProximityReporter(self.model, self._queries, observer, self.tick_s) if observer is not None else None
        )

    def _note_contact(self, robot: str, other: str) -> None:
        """Note a contact that begins, unless the same two have touched a moment before."""
        pair, now_s = frozenset((robot, other)), self._now_s()
        last_s = self._touched_s.get(pair, -math.inf)
        self._touched_s[pair] = now_s
        if now_s > last_s + _SAME_S and len(self.contacts) < _MAX_CONTACTS:
            self.contacts.append(Contact(now_s, robot, other))

    @property
    def robots(self) -> tuple[SimRobot, ...]:
        """The robots that have a place, in the order in which they got it. Thread: holds `lock`."""
        return self._placed

    @property
    def boxes(self) -> tuple[SimBox, ...]:
        """The movable boxes, in the order of the world file. Thread: holds `lock` for their poses."""
        return self._engine.boxes

    def robot_of(self, name: str) -> SimRobot | None:
        """Return the robot of that name, or None. Thread: any."""
        with self.lock:
            return self._robots.get(name)

    def join(
        self,
        name: str,
        make: Make,
        *,
        noise: bool,
        start: Pose2D | None,
        charge: float = 1.0,
        calibration: WheelCalibration = NOMINAL,
    ) -> SimRobot:
        """Return the robot of that name; create and place it if it is new.

        A robot stays in the world for good: after a restart of its software it joins again at its last pose.

        Args:
            name: the robot's name.
            make: its make.
            noise: whether its wheels have errors.
            start: x and y in metres and yaw in radians. None for one of the world's start poses, or a free place of a
                grid. These are assigned on first use of the world, in the order of the names, after the fleet joined.
            charge: initial charge of its battery, 0..1.
            calibration: its wheel calibration from now on.

        Raises:
            PluginError: the start is not free, or the robot is in the world as another make.
        """
        with self.lock:
            if known := self._robots.get(name):
                if (known.make, known.noise) != (make, noise):
                    raise PluginError(f"robot {name!r} is in the simulated world already, with other settings")
                if start is not None and known in self._without_start and known.motion is None:
                    self._start_at(known, start)  # a driver on a simulated port added it without a start
                known.calibration = calibration
                return known
            robot = SimRobot(
                name,
                make,
                noise=noise,
                group=next(self._groups),
                seed=self._seed,
                tick_s=self.tick_s,
                now_s=self._now_s,
                charge=charge,
                joined_s=self._due_tick() * self.tick_s,
            )
            robot.calibration = calibration
            if start is None:
                self._waiting.append(robot)
                self._without_start.add(robot)
            else:
                self._start_at(robot, start)
            self._robots[name] = robot
            return robot

    def _start_at(self, robot: SimRobot, start: Pose2D) -> None:
        if (why := self._why_taken(start, robot.make.radius_m, robot.filter)) is not None:
            raise PluginError(f"robot {robot.name!r} cannot start at x {start[0]:g} m, y {start[1]:g} m: {why}")
        self._place(robot, start)
        self._without_start.discard(robot)
        if robot in self._waiting:
            self._waiting.remove(robot)

    def carry(self, robot: SimRobot, pose: Pose2D) -> None:
        """Move a standing robot to another place, as a person would carry it. Thread: holds `lock`.

        Raises:
            ArgumentError: that place is not free.
            UnavailableError: the robot is driven.
        """
        if robot.motion is not None:
            raise UnavailableError(f"robot {robot.name!r} is driven: halt it before you move it")
        if (why := self._why_taken(pose, robot.make.radius_m, robot.filter)) is not None:
            raise ArgumentError(f"robot {robot.name!r} cannot stand at x {pose[0]:g} m, y {pose[1]:g} m: {why}")
        self._place(robot, pose)

    def start(self, robot: SimRobot, motion: WheelMotion) -> None:
        """Begin a robot's motion at the next tick, in place of the running one. Thread: holds `lock`.

        Raises:
            UnavailableError: the robot has no place in the world, or its battery is empty.
        """
        self.stop(robot)
        self._begin(robot, motion)

    def drive(self, robot: SimRobot, left_m_s: float, right_m_s: float, hold_s: float | None = None) -> None:
        """Set the target speeds of a robot's wheels, within its make's greatest. Thread: holds `lock`.

        Targets of 0 bring it to rest and put the brakes on. So does the end of `hold_s`; None is until the next call.

        Raises:
            UnavailableError: the robot has no place in the world, or its battery is empty.
        """
        most_m_s = robot.make.max_speed_m_s
        left_m_s, right_m_s = (min(max(speed_m_s, -most_m_s), most_m_s) for speed_m_s in (left_m_s, right_m_s))
        motion = robot.motion
        speeds_m_s = motion.speeds_m_s if isinstance(motion, VelocityDrive) else robot.wheel_speeds_m_s
        self._begin(robot, VelocityDrive(robot.make, speeds_m_s, (left_m_s, right_m_s), hold_s, self.tick_s))

    def stop(self, robot: SimRobot) -> None:
        """Stop a robot at once. Thread: holds `lock`."""
        if robot.motion is not None:
            robot.stop()
            self._driven.remove(robot)
            self._engine.settle(robot)

    def add_tick_callback(self, callback: TickCallback) -> None:
        """Call a function before each tick, until it returns False. Thread: holds `lock`."""
        if callback not in self._tick_callbacks:
            self._tick_callbacks.append(callback)

    def _begin(self, robot: SimRobot, motion: WheelMotion) -> None:
        was_driven = robot.motion is not None
        robot.start(motion)
        if not was_driven:
            self._driven.append(robot)
            self._engine.release(robot)
        self._without_start.discard(robot)
        if motion.is_over:
            self.stop(robot)

    def _now_s(self) -> float:
        return self._tick * self.tick_s

    def _due_tick(self) -> int:
        return math.floor(self._clock.now() * self._rate_hz + _ROUNDING)

    def catch_up(self) -> float:
        """Run the due ticks, and return the world's time in seconds of the fleet's clock. Thread: holds `lock`."""
        if self._waiting:
            self._place_waiting()
        due = self._due_tick()
        while self._tick < due and (self._tick_callbacks or self._driven or self._engine.is_awake):
            if self._tick_callbacks:
                now_s = self._now_s()
                self._tick_callbacks = [callback for callback in self._tick_callbacks if callback(now_s)]
            self._run_ticks(due - self._tick)
        self._tick = max(self._tick, due)
        if self._proximity is not None and self._proximity.is_stale:
            self._proximity.report(self._placed, self._tick)
        return self._now_s()

    def _run_ticks(self, most: int) -> None:
        """Run a few ticks, at most `most`.

        Robots that cannot touch anything meanwhile drive all the ticks at once, before the others.
        """
        self._mark_moved()
        ticks = 1 if self._tick_callbacks or self._proximity is not None else min(most, _TICKS_AT_ONCE)
        end = self._tick + ticks
        self._contacts.search(self._driven, self._free, self._tick, end)
        free = [robot for robot in self._driven if robot.clear_until_tick >= end]
        others = [robot for robot in self._driven if robot.clear_until_tick < end]
        for robot in others:
            robot.leave()
        alone = free
        if len(free) * ticks >= LEAST_WORK:
            alone = self._free.drive(free, self._tick, ticks)
        else:
            for robot in self._free.robots.copy():
                robot.leave()
        for robot in alone:
            robot.drive_on(self._tick, ticks)
        while self._tick < end:
            if not others and not self._engine.is_awake and self._proximity is None:
                self._tick = end  # nothing else moves
                break
            self._tick += 1
            self._run_tick(others, alone, end - self._tick)
            self._stop_done(others)
        self._stop_done(alone)

    def _run_tick(self, robots: list[SimRobot], alone: list[SimRobot], ahead: int) -> None:
        """Run a tick of robots that may touch something; all free robots are `ahead` ticks ahead."""
        for robot in robots:
            robot.predict()
        pushing = self._contacts.find(robots, self._tick, self._free, alone, ahead)
        stopped = self._engine.run_tick(pushing)
        for robot in robots:
            robot.arrive(stopped.get(robot, robot.next_pose) if stopped else robot.next_pose)
            if self._tick % robot.report_ticks == 0:
                robot.report_odometry(self._now_s())
        if self._proximity is not None:
            self._proximity.report(self._placed, self._tick)

    def _stop_done(self, robots: list[SimRobot]) -> None:
        """Stop the robots whose motion is over, and remove them from the list."""
        now_s = self._now_s()
        for robot in [robot for robot in robots if robot.is_done(now_s)]:
            robots.remove(robot)
            self.stop(robot)

    def _place_waiting(self) -> None:
        spots = list(places(self.model))
        for robot in sorted(self._waiting, key=lambda robot: _natural_key(robot.name)):
            radius_m = robot.make.radius_m
            free = (
                number
                for number, spot in enumerate(spots)
                if is_on_floor(self.model, spot, radius_m) and self._why_taken(spot, radius_m) is None
            )
            if (number := next(free, None)) is not None:
                self._place(robot, spots.pop(number))
        self._waiting.clear()

    def _place(self, robot: SimRobot, pose: Pose2D) -> None:
        robot.place(self._queries, pose)
        self._mark_moved()
        if robot not in self._placed:
            self._queries.add_disc(robot, robot.name, robot.make.radius_m, robot.filter)
            self._placed += (robot,)
        self._engine.settle(robot)
        self._contacts.expect(robot.make)
        for known in self._robots.values():
            known.clear_until_tick = 0
        if self._proximity is not None:
            self._proximity.is_stale = True

    def _mark_moved(self) -> None:
        """Make the copies of the poses stale: the space for queries and the arrays of the sensors."""
        self.version += 1
        self._queries.is_stale = True

    def _why_taken(self, pose: Pose2D, radius_m: float, ignoring: pymunk.ShapeFilter | None = None) -> str | None:
        """Return why a robot cannot stand there; None if it can."""
        x_m, y_m, _ = pose
        if not is_inside(self.model, x_m, y_m, radius_m):
            half_x_m, half_y_m = (size_m / 2 for size_m in self.model.size_m)
            room = f"the world {self.model.name!r} reaches from {-half_x_m:g} to {half_x_m:g} m in x"
            return f"{room} and from {-half_y_m:g} to {half_y_m:g} m in y"
        nearest = self._queries.space.point_query_nearest((x_m, y_m), radius_m, ignoring or pymunk.ShapeFilter())
        if nearest is None:
            return None
        name = self._queries.names[nearest.shape]
        return f"it would touch {f'robot {name!r}' if name in self._robots else name}"


def _natural_key(name: str) -> tuple[list[str | int], str]:
    """Return a sort key that puts robot2 before robot10."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", name)], name


def world_of(fleet: FleetServices) -> SimWorld:
    """Return the one world of a fleet. Thread: any."""
    settings = (fleet.clock, fleet.seed, fleet.world, fleet.proximity_observer, fleet.contacts, fleet.solid_robots)
    return fleet.shared("sim.world", lambda: SimWorld(*settings))
