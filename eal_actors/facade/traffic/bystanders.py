"""Bystanders: the robots of a fleet that stand while others travel, and leave a place to them where nothing else helps.

They are those that were not sent, those that have arrived, and those that gave up. One that has arrived returns. One
that is out of reach, stopped, busy, or held by another controller is an obstacle; so is one whose command failed in
another way than by being blocked, until the traffic ends.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Final

from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import Ping, RobotState
from eal_actors.device.navigation.traffic.errors import TrafficError
from eal_actors.device.navigation.traffic.roadmap import StandingDisc, Traveller
from eal_actors.facade.traffic.positions import RobotPositions
from eal_actors.facade.traffic.trips import Trip, TripGoal
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import BlockedError

_AT_GOAL_M: Final = 0.05  # a robot farther from its goal was moved by somebody after its arrival: it need not return


class Bystanders:
    """The robots that stand. Thread: that of the traffic control."""

    def __init__(self, robots: Mapping[str, RobotHandle], positions: RobotPositions, clock: Clock) -> None:
        self._robots = robots
        self._positions = positions
        self._clock = clock
        self._arrived: dict[str, Trip] = {}
        self._fixed: set[str] = set()

    def clear(self) -> None:
        """Forget who has arrived and who has failed."""
        self._arrived.clear()
        self._fixed.clear()

    def note(self, trip: Trip) -> None:
        """Note the end of a robot's trip."""
        name, error = trip.robot.name, trip.exception()
        if error is None and not trip.makes_way:
            self._arrived[name] = trip
        elif error is not None:
            self._arrived.pop(name, None)
            if not isinstance(error, BlockedError | TrafficError):
                self._fixed.add(name)

    def standing(self, moving: Iterable[str]) -> list[StandingDisc]:
        """Return all robots but those that move as obstacles."""
        places, radii_m, moving = self._positions.places, self._positions.radii_m, set(moving)
        return [
            StandingDisc(name, place, radii_m[name]) for name in places if name not in moving for place in places[name]
        ]

    def movable(self, moving: Iterable[str]) -> list[Traveller]:
        """Return those that can make way. Thread: blocks the caller for some seconds of real time at most."""
        moving = {*moving, *self._fixed}
        pings = {name: self._robots[name].ping() for name in self._positions.known if name not in moving}
        return [
            self._traveller(name) for name, ping in pings.items() if ping.exception() is None and _is_idle(ping.get())
        ]

    def errand(self, traveller: Traveller, timeout_s: float, give_up: Callable[[Trip], None]) -> Trip:
        """Return the trip of a robot that makes way; if it is to return, its journey waits for that."""
        before = self._arrived.pop(traveller.name, None)
        goal = before.goal if before is not None else TripGoal(traveller.goal, None)
        trip = Trip(self._robots[traveller.name], goal, self._clock, timeout_s, give_up)
        trip.is_new, trip.makes_way = False, traveller.makes_way
        if before is not None and before.journey is not None and not traveller.makes_way:
            before.journey.await_return(trip)
            trip.journey = before.journey
        return trip

    def _traveller(self, name: str) -> Traveller:
        place, radius_m, trip = self._positions.places[name][0], self._positions.radii_m[name], self._arrived.get(name)
        if trip is not None and math.dist(place, trip.goal.point) <= _AT_GOAL_M:
            return Traveller(name, place, trip.goal.point, radius_m)
        self._arrived.pop(name, None)
        return Traveller(name, place, place, radius_m, makes_way=True)


def _is_idle(ping: Ping) -> bool:
    """Return whether nobody commands the robot's base, and nothing keeps it from moving."""
    is_ours = "Base" not in ping.holders or "Base" in ping.holder_ids
    is_able = ping.state is RobotState.READY and ping.stopped is None and "Base" not in ping.not_ready
    return is_ours and is_able and all(command.resource != "Base" for command in ping.running)
