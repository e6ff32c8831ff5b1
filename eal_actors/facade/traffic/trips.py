"""The futures of `Fleet.go_to`: a trip for each robot, and the journey of all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from typing_extensions import override

from eal_actors.actors.future import CallSoon, Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.device.localization.pose_estimate import Point
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import EALError


@dataclass(frozen=True, slots=True)
class TripGoal:
    """Where a robot is to be. Its point is x and y in m in the map frame; `yaw_deg` is None for any heading."""

    point: Point
    yaw_deg: float | None


class Trip(Future[int]):
    """One robot's way to its goal; done on its arrival, with 1.

    Attributes:
        obstacles: how many obstacles on no map it has met.
        hindrance: the error of the last of them.
        is_new: whether it has not been planned yet.
        makes_way: whether it only leaves a place to others.
        journey: which it is a part of; None for a robot that was not sent.
    """

    def __init__(
        self, robot: RobotHandle, goal: TripGoal, clock: Clock, timeout_s: float, give_up: Callable[[Trip], None]
    ) -> None:
        super().__init__(clock, clock.now() + timeout_s)
        self.robot = robot
        self.goal = goal
        self.obstacles = 0
        self.hindrance: EALError | None = None
        self.is_new = True
        self.makes_way = False
        self.journey: Journey | None = None
        self._give_up = give_up

    @override
    def describe(self) -> str:
        x_m, y_m = self.goal.point
        return f"{self.robot.name}: go_to ({x_m:g}, {y_m:g})"

    @override
    def _given_up(self) -> None:
        self._give_up(self)


class Journey(Future[dict[str, int]]):
    """The trips of some robots; done when each has arrived or failed.

    Its result is 1 for each robot's name. It fails with the error of the first robot, in the order given, that has not
    arrived; `arrivals` has the outcome of each. It also waits for robots that have arrived, made way for others and are
    on their way back. Cancelling it stops the robots. `arrivals` has the future of each robot's arrival, by name.
    """

    def __init__(self, clock: Clock, trips: Sequence[Trip]) -> None:
        super().__init__(clock, max((trip.deadline_s or 0.0 for trip in trips), default=None))
        self.arrivals: Mapping[str, Future[int]] = {trip.robot.name: trip for trip in trips}
        self._trips = [*trips]
        if not trips:
            self.set({})
        for trip in trips:
            trip.journey = self
            trip.link(self._note)

    def await_return(self, trip: Trip) -> None:
        """Wait for a robot that has arrived and makes way, too; whether it returns does not change the outcome."""
        self._trips.append(trip)
        trip.link(self._note)

    def _note(self, _: Future[int], call_soon: CallSoon | None) -> None:
        if not all(trip.done() for trip in self._trips):
            return
        error = next((error for trip in self.arrivals.values() if (error := trip.exception()) is not None), None)
        self.settle(dict.fromkeys(self.arrivals, 1) if error is None else None, error, call_soon)

    @override
    def describe(self) -> str:
        return f"go_to of {len(self.arrivals)} robots"

    @override
    def expire(self) -> None:
        """Let each trip fail with its own deadline: its message names the robot."""
        for trip in self._trips:
            trip.expire()

    @override
    def _given_up(self) -> None:
        for trip in self._trips:
            trip.cancel()
