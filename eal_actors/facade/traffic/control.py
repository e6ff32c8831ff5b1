"""Traffic control: one plan for all robots of a fleet that are on their way, carried out move by move.

- One thread plans, sends moves and hears of their ends; it ends with the last trip.
- A robot enters a place when those that pass it before have left. This order is the plan; its times are not. So delays,
  stops and slow robots cost time and nothing else.
- Whatever changes the plan (a new goal, a robot that fails, an obstacle on no map) waits until the moves that were sent
  are over. Then the poses are read and everybody is planned anew.
- Robots that are not on their way stand: the others drive round them. Where there is no plan for that, those that can
  make way; see `Bystanders`. Only what has no plan even then fails.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from eal_actors.actors.handles import RobotHandle
from eal_actors.device.localization.pose_estimate import Point
from eal_actors.device.navigation.grid import FREE, GridOrigin, OccupancyGrid
from eal_actors.device.navigation.traffic.errors import TrafficError
from eal_actors.device.navigation.traffic.planner import TrafficPlan, plan_traffic
from eal_actors.device.navigation.traffic.roadmap import StandingDisc, Traveller
from eal_actors.device.navigation.world_grid import RESOLUTION_M
from eal_actors.facade.traffic.bystanders import Bystanders
from eal_actors.facade.traffic.plan_run import PlanRun
from eal_actors.facade.traffic.positions import RobotPositions
from eal_actors.facade.traffic.trips import Journey, Trip, TripGoal
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import EALError, PreemptedError, UnavailableError
from eal_actors.kernel.log import get_logger

MOST_OBSTACLES: Final = 3
"""A robot that meets one more obstacle on no map gives up."""
_GATHER_S: Final = 0.02  # requests of one moment, each by a thread of its own, are planned together
_OBSTACLE_RADIUS_M: Final = 0.2
_OBSTACLE_GAP_M: Final = 0.05
_OPEN_FLOOR_M: Final = 3.0  # of a fleet without a map, the floor around its robots and goals counts as free so far


class TrafficControl:
    """Brings the robots of a fleet to their goals; see `Fleet.go_to`.

    `floor` is the map, not inflated, None for an open floor; `seed` is that of choices between equal plans.
    """

    def __init__(self, robots: Mapping[str, RobotHandle], clock: Clock, floor: OccupancyGrid | None, seed: int) -> None:
        self._clock = clock
        self._seed = seed
        self._positions = RobotPositions(robots)
        self._bystanders = Bystanders(robots, self._positions, clock)
        self._lock = threading.Lock()
        self._requests: deque[Trip] = deque()
        self._thread: threading.Thread | None = None
        self._run: PlanRun | None = None
        self._trips: dict[str, Trip] = {}
        self._obstacles: list[StandingDisc] = []
        self._grid = floor

    def start(self, goals: Mapping[RobotHandle, TripGoal], timeout_s: float) -> Journey:
        """Begin the trips of some robots; trips of others continue. Thread: any; does not block."""
        trips = [Trip(robot, goal, self._clock, timeout_s, self._give_up) for robot, goal in goals.items()]
        with self._lock:
            self._requests.extend(trips)
            if trips and self._thread is None:
                self._thread = threading.Thread(target=self._work, name="traffic control", daemon=True)
                self._clock.start(self._thread)
        self._wake()
        return Journey(self._clock, trips)

    def cancel(self) -> None:
        """Cancel all trips and halt their robots. Thread: any; does not block."""
        while True:
            with self._lock:
                trips = [trip for trip in (*self._requests, *self._trips.values()) if not trip.done()]
            if not trips:
                return
            for trip in trips:
                trip.cancel()

    def close(self, timeout_s: float) -> None:
        """Cancel all trips, and wait for the thread to end. Thread: blocks the caller."""
        self.cancel()
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            with self._clock.outside():
                thread.join(timeout_s)

    def _give_up(self, trip: Trip) -> None:
        trip.robot.halt()
        self._wake()

    def _wake(self) -> None:
        if (run := self._run) is not None:
            run.wake()

    # The thread of the traffic control.

    def _work(self) -> None:
        try:
            while self._admit():
                self._drive()
        except Exception as error:  # noqa: BLE001  # whatever it is, no robot may be left driving or waiting
            get_logger().exception("the traffic control failed")
            with self._lock:
                self._thread = None
                trips = [*self._requests, *self._trips.values()]
                self._requests.clear()
            for trip in trips:
                trip.robot.halt()
                trip.fail(UnavailableError(f"the traffic control failed: {error}", robot=trip.robot.name))

    def _admit(self) -> bool:
        """Take over the requests; return False if there is nothing to do, and the thread ends."""
        self._clock.sleep(_GATHER_S)
        with self._lock:
            newest = {trip.robot.name: trip for trip in self._requests}
            replaced = [trip for trip in self._requests if newest[trip.robot.name] is not trip]
            replaced += [self._trips.pop(name) for name in newest if name in self._trips]
            self._requests.clear()
            for name, trip in list(self._trips.items()):
                if trip.done() or trip.makes_way:
                    self._end(name)
            self._trips |= {name: trip for name, trip in newest.items() if not trip.done()}
            if not self._trips:
                self._thread, self._run = None, None
                self._obstacles.clear()
                self._bystanders.clear()
        for trip in replaced:
            trip.fail(PreemptedError("a newer go_to replaced this one", robot=trip.robot.name))
        return bool(self._trips)

    def _end(self, name: str, error: EALError | None = None) -> None:
        """Take a trip out; it fails if there is an error, and one that only makes way is over wherever the robot is."""
        trip = self._trips.pop(name)
        if error is not None:
            trip.fail(error)
        elif trip.makes_way:
            trip.set(1)
        self._bystanders.note(trip)

    def _drive(self) -> None:
        """Plan, and carry the plan out until all trips have ended or it must be planned anew."""
        for name, error in self._positions.read(self._trips, self._clock).items():
            self._end(name, error)
        plan = self._plan()
        starts = {name: self._positions.places[name][0] for name in plan.moves}
        self._run = run = PlanRun(plan, self._trips, starts, self._clock)
        run.run(lambda: bool(self._requests))
        for name, leg in run.legs.items():
            self._positions.places[name] = leg.ends if leg.trip.done() and not leg.has_arrived else leg.ends[:1]
        for leg in run.blocked:
            self._note_obstacle(leg.trip, leg.ends)

    def _note_obstacle(self, trip: Trip, ends: tuple[Point, Point]) -> None:
        """Close the place before a blocked robot."""
        trip.obstacles += 1
        if trip.obstacles > MOST_OBSTACLES and trip.hindrance is not None:
            trip.fail(trip.hindrance)
            return
        (x_m, y_m), (to_x_m, to_y_m) = ends
        ahead_m = self._positions.radii_m[trip.robot.name] + _OBSTACLE_GAP_M + _OBSTACLE_RADIUS_M
        share = ahead_m / max(math.dist(*ends), 1e-3)
        at = x_m + share * (to_x_m - x_m), y_m + share * (to_y_m - y_m)
        self._obstacles.append(StandingDisc(f"what blocked {trip.robot.name}", at, _OBSTACLE_RADIUS_M))

    def _plan(self) -> TrafficPlan:
        """Plan the trips; those without a way fail, and the others are planned without them."""
        while True:
            radii_m, places = self._positions.radii_m, self._positions.places
            travellers = [
                Traveller(name, places[name][0], trip.goal.point, radii_m[name]) for name, trip in self._trips.items()
            ]
            try:
                plan = self._plan_for(travellers)
            except TrafficError as error:
                if (alternative := self._plan_with_bystanders(travellers)) is None:
                    self._fail_or_forget(error)
                    continue
                plan = alternative
            for trip in self._trips.values():
                trip.is_new = False
            return replace(plan, moves={name: moves for name, moves in plan.moves.items() if name in self._trips})

    def _plan_for(self, travellers: Sequence[Traveller]) -> TrafficPlan:
        grid = self._grid if self._grid is not None else open_floor(travellers)
        standing = self._bystanders.standing(traveller.name for traveller in travellers)
        return plan_traffic(grid, travellers, [*standing, *self._obstacles], seed=self._seed)

    def _plan_with_bystanders(self, travellers: Sequence[Traveller]) -> TrafficPlan | None:
        """Plan with those that can make way; those that cannot even so stand. Return None if there is no plan."""
        movable = {traveller.name: traveller for traveller in self._bystanders.movable(self._trips)}
        while movable:
            try:
                plan = self._plan_for([*travellers, *movable.values()])
            except TrafficError as error:
                if not (stuck := movable.keys() & set(error.robots)):
                    return None
                for name in stuck:
                    del movable[name]
            else:
                self._send_away([movable[name] for name in movable if plan.moves[name]])
                return plan
        return None

    def _send_away(self, bystanders: Sequence[Traveller]) -> None:
        """Begin the trips of those that make way; none of them moves if all others were cancelled meanwhile."""
        latest_s = max(trip.deadline_s or 0.0 for trip in self._trips.values()) - self._clock.now()
        errands = {one.name: self._bystanders.errand(one, latest_s, self._give_up) for one in bystanders}
        with self._lock:
            is_over = all(trip.done() for trip in self._trips.values())
            self._trips |= errands
        if is_over:
            for trip in errands.values():
                trip.set(1)

    def _fail_or_forget(self, error: TrafficError) -> None:
        """Fail the trips that have no plan; if one of them is new, all new ones, so that nobody of them moves.

        What blocked others is no reason: it may have been their own wheels. It is forgotten until it is met again.
        """
        names = self._trips.keys() & set(error.robots) or set(self._trips)
        if self._obstacles and all(self._trips[name].hindrance is None for name in names):
            self._obstacles.clear()
            return
        if any(self._trips[name].is_new for name in names):
            names = {name for name, trip in self._trips.items() if trip.is_new}
        for name in [name for name in self._trips if name in names]:
            self._end(name, self._trips[name].hindrance or error.copy())


def open_floor(travellers: Sequence[Traveller]) -> OccupancyGrid:
    """Return a free grid around the robots and their goals."""
    ends = [point for traveller in travellers for point in (traveller.start, traveller.goal)]
    points = np.array(ends or [(0.0, 0.0)])
    low, high = points.min(axis=0) - _OPEN_FLOOR_M, points.max(axis=0) + _OPEN_FLOOR_M
    columns, rows = np.ceil((high - low) / RESOLUTION_M).astype(int)
    origin = GridOrigin(float(low[0]), float(low[1]))
    return OccupancyGrid(np.full((rows, columns), FREE, np.int8), RESOLUTION_M, origin)
