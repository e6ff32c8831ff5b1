"""Carries out one plan: sends each move when those before it are over, and hears of their ends."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Final

from eal_actors.device.navigation.traffic.planner import TrafficPlan
from eal_actors.facade.traffic.legs import Leg
from eal_actors.facade.traffic.trips import Trip
from eal_actors.kernel.clock import Clock, new_waiter
from eal_actors.kernel.errors import BlockedError, NotReadyError, UnavailableError

SILENCE_S: Final = 15.0
"""A robot on its way that reports nothing for so long has failed."""
MOST_TRIES: Final = 3
"""How often a blocked robot tries before its way counts as closed; each try takes about 5 s."""
MOST_TRIES_AT_GOAL: Final = 12
"""The same on its last move: no other way leads to a goal that something covers."""
_LOOK_S: Final = 1.0


class PlanRun:
    """The robots of one plan on their ways. `blocked` are those whose next place is closed by something on no map.

    Thread: one thread uses it; `wake` is for any.
    """

    def __init__(
        self, plan: TrafficPlan, trips: Mapping[str, Trip], starts: Mapping[str, tuple[float, float]], clock: Clock
    ) -> None:
        self.legs = {name: Leg(trips[name], moves, starts[name], self._note) for name, moves in plan.moves.items()}
        self.blocked: list[Leg] = []
        self._clock = clock
        self._waiter = new_waiter()
        self._heard: deque[Leg] = deque()
        self._to_cut = list(self.legs.values())
        self._followers: dict[str, dict[str, None]] = {name: {} for name in plan.moves}
        for name, moves in plan.moves.items():
            for move in moves:
                for other, _ in move.waits_for:
                    self._followers[other][name] = None

    def _note(self, leg: Leg) -> None:
        self._heard.append(leg)
        self.wake()

    def wake(self) -> None:
        """Let `run` look again at what is outdated. Thread: any; does not block."""
        self._clock.wake(self._waiter)

    def run(self, is_outdated: Callable[[], bool]) -> None:
        """Drive until every trip has ended; or until new goals make the plan outdated, and every robot stands.

        Thread: blocks the caller.
        """
        if not self._must_end():
            self._send(self.legs)
        while any(not leg.trip.done() for leg in self.legs.values()):
            if self._must_end() or is_outdated():
                if not any(leg.is_driving for leg in self.legs.values()):
                    return
                self._cut_short()
            self._clock.wait(self._waiter, _LOOK_S)
            heard = dict.fromkeys(self._heard.popleft() for _ in range(len(self._heard)))
            touched = dict.fromkeys(name for name, leg in self.legs.items() if leg.is_due_again)
            for leg in heard:
                if self._update(leg):
                    touched |= {leg.trip.robot.name: None, **self._followers[leg.trip.robot.name]}
            self._check_time()
            if not (self._must_end() or is_outdated()):
                self._send(touched)

    def _cut_short(self) -> None:
        """Let everybody stop soon, once."""
        legs, self._to_cut = self._to_cut, []
        for leg in legs:
            if not leg.trip.done():
                leg.cut_short()
                if leg.trip.done():  # as in `_send`
                    leg.trip.robot.halt()

    def _must_end(self) -> bool:
        return bool(self.blocked) or any(leg.trip.done() and not leg.has_arrived for leg in self.legs.values())

    def _send(self, names: Iterable[str]) -> None:
        for name in names:
            leg = self.legs[name]
            if not leg.trip.done():
                leg.send(self.legs)
                if leg.has_arrived:
                    leg.trip.set(1)
                elif leg.trip.done():  # cancelled meanwhile, so it may have been halted before the command came
                    leg.trip.robot.halt()

    def _update(self, leg: Leg) -> bool:
        """Read how far a robot has come; return whether it or another one may have moves to be sent."""
        before = leg.done
        if (error := leg.update()) is None:
            return leg.done > before or leg.call is None
        if leg.trip.done():
            return False
        if isinstance(error, NotReadyError) and leg.note_absence() < SILENCE_S:
            return False
        if not isinstance(error, BlockedError):
            self._fail(leg, error)
            return False
        leg.tries += 1
        if leg.tries < (MOST_TRIES_AT_GOAL if leg.is_at_last_move else MOST_TRIES):
            return True
        if leg.is_at_last_move:
            self._fail(leg, error)
        else:
            leg.trip.hindrance = error
            self.blocked.append(leg)
        return False

    def _check_time(self) -> None:
        """Let trips fail whose deadline has passed, or whose robot is silent."""
        for name, leg in self.legs.items():
            if leg.trip.done():
                continue
            if leg.trip.deadline_s is not None and self._clock.now() >= leg.trip.deadline_s:
                leg.trip.expire()
            elif leg.is_driving and leg.silence_s() > SILENCE_S:
                why = f"it has not been heard of for {SILENCE_S:g} s on its way"
                self._fail(leg, UnavailableError(why, robot=name))

    @staticmethod
    def _fail(leg: Leg, error: BaseException) -> None:
        leg.trip.fail(error)
        leg.give_up()
        leg.trip.robot.halt()
