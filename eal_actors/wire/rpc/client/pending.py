"""PendingCalls: the calls to one robot that wait for their replies.

A call and its reply are two publications that only the call's number connects. When no reply will come, the robot's
liveliness token disappears or the call's time runs out; both end the call here. Each call ends once, since the
thread that takes it out of the dictionary ends it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, NamedTuple, Protocol

from eal_actors.actors.call import Call
from eal_actors.wire.format.messages import Answer, CallId, RobotTime


class PendingCall(Protocol):
    """Call that waits for a reply. One of its three methods is called, once; none may block the readers' threads."""

    @property
    def end_s(self) -> float:
        """Real time at which it times out."""

    def answered(self, answer: Answer, time: RobotTime | None) -> None:
        """Handle the answer and, if included, the robot's clock. Thread: a reader's."""

    def lost(self) -> None:
        """Handle that the robot is unreachable. Thread: any."""

    def timed_out(self) -> None:
        """Handle that its time is over. Thread: any."""


class PendingCalls:
    """Pending calls of one robot by their numbers, added before they are sent. Thread: any."""

    def __init__(self) -> None:
        self.calls: Final[dict[int, PendingCall]] = {}

    def _take_all(self) -> Iterator[PendingCall]:
        for number in list(self.calls):
            call = self.calls.pop(number, None)
            if call is not None:
                yield call

    def answer_all(self, answer: Answer, time: RobotTime | None) -> None:
        """Pass a reply to all: the robot could not decode the number of its call."""
        for call in self._take_all():
            call.answered(answer, time)

    def lose_all(self) -> None:
        """Report all as lost: the robot is unreachable."""
        for call in self._take_all():
            call.lost()

    def expire(self, now_s: float) -> None:
        """Report those whose time is over at a real time."""
        for number, call in list(self.calls.items()):
            if call.end_s <= now_s and self.calls.pop(number, None) is not None:
                call.timed_out()


class SentCall(NamedTuple):
    """Call of a resource's method that was sent; commands have an identifier. A PendingCall."""

    queue: Any  # the CallQueue, which imports this module
    call: Call[Any]
    call_id: CallId | None
    end_s: float

    def answered(self, answer: Answer, time: RobotTime | None) -> None:
        """Resolve the call."""
        self.queue.conclude(self.call, self.call_id, answer, time)

    def lost(self) -> None:
        """Retry the call, or ask for its outcome."""
        self.queue.window.answered(self.call)
        self.queue.lose(self.call, self.call_id)

    def timed_out(self) -> None:
        """Fail the call."""
        self.queue.window.answered(self.call)
        self.queue.expire(self.call)
