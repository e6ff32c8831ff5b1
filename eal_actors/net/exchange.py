"""Exchanges: what one robot was asked and has not answered yet.

A call and its answer are two publications, which nothing joins but the number of the call. Where no answer will come,
that is told by the robot's sign of life, which goes, or by the time, which runs out.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Protocol

from eal_actors.actors.call import Call
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.net.controller import Controller
from eal_actors.net.pacing import Pace
from eal_actors.net.sender import UrgentMessage
from eal_actors.net.wire import Answer, CallHeader, CallId, Reply, RobotTime, encode_call


class Exchange(ABC):
    """Something that was asked. One of its three methods is called, once; they must not hold up zenoh's threads.

    Attributes:
        end_s: the real time at which it runs out.
    """

    __slots__ = ()

    end_s: float

    @abstractmethod
    def answered(self, answer: Answer, time: RobotTime | None) -> None:
        """Take in the answer, and the robot's clock if it came along. Thread: zenoh's."""

    @abstractmethod
    def lost(self) -> None:
        """Take note that the robot is not there (any more). Thread: any."""

    @abstractmethod
    def ran_out(self) -> None:
        """Take note that its time is over. Thread: any."""


class Exchanges:
    """The exchanges of one robot by the numbers of their calls. Thread: any."""

    def __init__(self) -> None:
        self._open: dict[int, Exchange] = {}

    def open(self, number: int, exchange: Exchange) -> None:
        """Wait for an answer; call it before the call leaves."""
        self._open[number] = exchange

    def answer(self, reply: Reply) -> bool:
        """Pass on an answer; one to a call that the robot could not read is for all, as nobody knows which it was.

        Returns:
            Whether anybody waited for it.
        """
        is_due = False
        for number in (reply.sequence,) if reply.sequence else list(self._open):
            exchange = self._open.pop(number, None)
            if exchange is not None:
                is_due = True
                exchange.answered(reply.answer, reply.time)
        return is_due

    def lose(self) -> None:
        """Give all up: the robot is not there."""
        for number in list(self._open):
            exchange = self._open.pop(number, None)
            if exchange is not None:
                exchange.lost()

    def look(self, now_s: float) -> None:
        """Give up those whose time is over."""
        for number, exchange in list(self._open.items()):
            if exchange.end_s <= now_s and self._open.pop(number, None) is not None:
                exchange.ran_out()


class Question(UrgentMessage, Exchange):
    """A call of the robot itself, with the times that tell how far its clock is from ours.

    Args:
        controller: the fleet's end of the network.
        robot: whom to ask.
        exchanges: of the robot.
        key: of the call.
        header: of the call; its time to live is how long to wait for an answer.
        take: called with the answer, the robot's clock if it came along, and our clock (REAL_TIME) as the call left
            and as the answer came.
        miss: called when there is to be none.
        is_urgent: send it past everything that waits.
        insist: called with what sends it, should it still wait for another one's link; see UrgentMessage.

    Thread: `take` and `miss` run in zenoh's, which they must not hold up.
    """

    def __init__(
        self,
        controller: Controller,
        robot: str,
        exchanges: Exchanges,
        key: str,
        header: CallHeader,
        take: Callable[[Answer, RobotTime | None, float, float], None],
        miss: Callable[[], None],
        *,
        is_urgent: bool = False,
        insist: Callable[[Callable[[], None]], None] | None = None,
    ) -> None:
        self._is_urgent = is_urgent
        self._insist = insist
        self._is_taken = threading.Lock()  # by whoever sends it
        self._controller = controller
        self._robot = robot
        self._exchanges = exchanges
        self._key = key
        self._header = header
        self._take = take
        self._sent_s = 0.0
        self._miss = miss

    def send(self, *, is_last: bool) -> None:
        """See Message."""
        if not self._is_taken.acquire(blocking=False):
            return
        header = self._header
        envelope, payload = encode_call(header._replace(has_more=not is_last))
        self._sent_s = REAL_TIME.now()
        self.end_s = self._sent_s + header.ttl_s
        self._exchanges.open(header.sequence, self)
        put = self._controller.put
        if not put(self._robot, self._key, envelope, payload, is_urgent=self._is_urgent, is_last=is_last):
            self._exchanges.lose()

    def insist(self) -> None:
        """See UrgentMessage."""
        if self._insist is not None and not self._is_taken.locked():
            self._insist(lambda: self.send(is_last=True))

    def answered(self, answer: Answer, time: RobotTime | None) -> None:
        """See Exchange."""
        self._take(answer, time, self._sent_s, REAL_TIME.now())

    def lost(self) -> None:
        """See Exchange."""
        self._miss()

    def ran_out(self) -> None:
        """See Exchange."""
        self._miss()


class Asker(Protocol):
    """Who has asked for calls of resources; see Lane. Thread: as in Exchange."""

    @property
    def pace(self) -> Pace:
        """Counts what is unanswered."""
        ...

    def conclude(self, call: Call[Any], call_id: CallId, answer: Answer, time: RobotTime | None) -> None:
        """Give a call its outcome."""
        ...

    def miss(self, call: Call[Any], call_id: CallId) -> None:
        """Take note that the robot is not there to answer."""
        ...

    def expire(self, call: Call[Any]) -> None:
        """Take note that the deadline has passed without an answer."""
        ...


class AskedCall(Exchange):
    """A call of a method of a resource that has left."""

    __slots__ = ("_asker", "_call", "_call_id", "end_s")

    def __init__(self, asker: Asker, call: Call[Any], call_id: CallId, end_s: float) -> None:
        self._asker = asker
        self._call = call
        self._call_id = call_id
        self.end_s = end_s

    def answered(self, answer: Answer, time: RobotTime | None) -> None:
        """See Exchange."""
        self._asker.pace.answered()
        self._asker.conclude(self._call, self._call_id, answer, time)

    def lost(self) -> None:
        """See Exchange."""
        self._asker.pace.answered()
        self._asker.miss(self._call, self._call_id)

    def ran_out(self) -> None:
        """See Exchange."""
        self._asker.pace.answered()
        self._asker.expire(self._call)
