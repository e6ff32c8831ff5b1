"""A leg: the moves of one robot in a plan, how many have been sent to it, and how many are over."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from eal_actors.actors.call import Call
from eal_actors.device.localization.pose_estimate import Point
from eal_actors.device.navigation.traffic.planner import TrafficMove
from eal_actors.facade.traffic.trips import Trip

_PASSED_M: Final = 0.005  # a robot so near a place has left the one before: the margin between hulls allows for it
_GAIN_M: Final = 0.02  # a blocked robot that has come so much nearer to the next place has not tried in vain
_LAST_MOVES: Final = 2
"""A robot that must stop for a new plan goes so many places further: it may be near the next one already."""
_RETRY_S: Final = 1.0
_CALL_S: Final = 20.0
_CALL_S_PER_M: Final = 30.0
_CALL_S_PER_MOVE: Final = 8.0  # the deadline of a command: a turn and a drive at a tenth of the usual speed


class Leg:
    """The moves of one robot in a plan. `notify` is called, in any thread, when the robot may have come farther.

    Attributes:
        done: the number of moves that are over.
        call: the running command; None while it has none.
        tries: how often it was blocked since it last came nearer to the next place.
        has_arrived: whether it is at its goal, with the heading there.
    """

    def __init__(self, trip: Trip, moves: Sequence[TrafficMove], start: Point, notify: Callable[[Leg], None]) -> None:
        self.trip = trip
        self.moves = moves
        self.done = 0
        self.call: Call[int] | None = None
        self._heard_s = trip.clock.now()
        self._absent_since_s: float | None = None
        self._next_try_s = -math.inf
        self.tries = 0
        self.has_arrived = False
        self._places = [start, *(move.to for move in moves)]
        self._sent = 0
        self._sent_from = 0
        self._notify = notify

    @property
    def is_driving(self) -> bool:
        """Whether a command runs."""
        return self.call is not None and not self.call.done()

    def silence_s(self) -> float:
        """Return the time since the robot was heard of."""
        progress = self.call.progress() if self.call is not None else None
        if progress is not None:
            self._heard_s = max(self._heard_s, progress.time_s)
        return self.trip.clock.now() - self._heard_s

    def note_absence(self) -> float:
        """Note that the robot's device is not ready, and try again later; return the time since it was ready."""
        now_s = self.trip.clock.now()
        if self._absent_since_s is None:
            self._absent_since_s = now_s
        self._next_try_s = now_s + _RETRY_S
        return now_s - self._absent_since_s

    @property
    def is_due_again(self) -> bool:
        """Whether its command is to be sent again, because its device was not ready."""
        return self.call is None and self._absent_since_s is not None and self.trip.clock.now() >= self._next_try_s

    def give_up(self) -> None:
        """End the running command, whether the robot answers or not."""
        if self.call is not None:
            self.call.cancel()

    @property
    def is_at_last_move(self) -> bool:
        """Whether only the move to its goal, or the turn there, is left."""
        return self.done >= len(self.moves) - 1

    @property
    def ends(self) -> tuple[Point, Point]:
        """Where it was blocked last, or the place that it has left or stands on; and the next one."""
        return self._places[self.done], self._places[min(self.done + 1, len(self.moves))]

    def send(self, done: Mapping[str, Leg]) -> None:
        """Send the moves that may begin, and at the goal the turn to its heading.

        A running command is replaced by a longer one when its last move has begun.
        """
        if self.call is None and self._absent_since_s is not None and not self.is_due_again:
            return
        cleared = self.done
        while cleared < len(self.moves) and all(
            done[name].done >= count for name, count in self.moves[cleared].waits_for
        ):
            cleared += 1
        if cleared > self._sent and (self.call is None or self._sent - self.done <= 1):
            self._follow(cleared)
        elif self.call is None and self.done == len(self.moves):
            goal = self.trip.goal
            if self.moves and goal.yaw_deg is None:
                self.has_arrived = True
            else:
                self._start(self.trip.robot.base.go_to(*goal.point, goal.yaw_deg, timeout_s=_CALL_S + _CALL_S_PER_MOVE))

    def cut_short(self) -> None:
        """Let the running command end after the next places, because the plan is outdated."""
        if self.is_driving and self.done + _LAST_MOVES < self._sent:
            self._follow(self.done + _LAST_MOVES)

    def _follow(self, end: int) -> None:
        self._sent, self._sent_from = end, self.done
        way = self._places[self.done : end + 1]
        length_m = sum(itertools.starmap(math.dist, itertools.pairwise(way)))
        timeout_s = _CALL_S + _CALL_S_PER_M * length_m + _CALL_S_PER_MOVE * len(way)
        self._start(self.trip.robot.base.follow(way[1:], timeout_s=timeout_s))

    def _start(self, call: Call[int]) -> None:
        self.call = call
        self._heard_s = self.trip.clock.now()
        call.add_progress_callback(lambda _: self._notify(self))
        call.add_done_callback(lambda _: self._notify(self))

    def update(self) -> BaseException | None:
        """Read how far the robot has come; return the error of its command if that has failed."""
        if (call := self.call) is None:
            return None
        before, progress = self.done, call.progress()
        share = (progress.fraction if progress is not None else None) or 0.0
        if not call.done():
            self._pass_places(share)
        else:
            self.call = None
            if (error := call.exception()) is not None:
                self._note_failure(share)
                return error
            if self.done == len(self.moves) and self._sent == self._sent_from:
                self.has_arrived = True
            self.done = self._sent_from = self._sent
        if self.done > before:
            self.tries, self._absent_since_s = 0, None
        return None

    def _note_failure(self, share: float) -> None:
        """Note where the robot stands; what is left of its way is to be sent again."""
        before, left_m = self._places[self.done], self._pass_places(share)
        here, there = self.ends
        part = min(left_m / max(math.dist(here, there), 1e-6), 1.0)
        self._places[self.done] = there[0] + part * (here[0] - there[0]), there[1] + part * (here[1] - there[1])
        if math.dist(before, self._places[self.done]) >= _GAIN_M:
            self.tries, self._absent_since_s = 0, None
        self._sent = self._sent_from = self.done

    def _pass_places(self, share: float) -> float:
        """Count the places that the robot has passed, by the share of its way that it has reported.

        Returns the distance to the next one. The share is of the way from where the robot was when the command began,
        which is at most that from the place before: so a place counts late rather than early.
        """
        way = self._places[self._sent_from : self._sent + 1]
        lengths_m = [math.dist(here, there) for here, there in itertools.pairwise(way)]
        left_m = (1.0 - share) * sum(lengths_m)
        after_m = sum(lengths_m[self.done - self._sent_from + 1 :])
        while self.done < self._sent - 1 and left_m <= after_m + _PASSED_M:
            self.done += 1
            after_m -= lengths_m[self.done - self._sent_from]
        return left_m - after_m
