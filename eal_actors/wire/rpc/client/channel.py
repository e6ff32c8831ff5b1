"""Channel: the connection to one robot, shared by its call queue, its streams and requests to the robot itself.

A call and its reply are two publications that only the call's number connects. When no reply will come, the robot's
liveliness token disappears or the call's time runs out. Each call ends once, since the thread that takes it out of
`Channel.pending` ends it: by one of its methods `answered`, `lost` and `timed_out`.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, TypeVar

from eal_actors.actors.actor import EALActor
from eal_actors.actors.call import Call
from eal_actors.actors.future import Future
from eal_actors.actors.robot_view import RobotState, RobotView
from eal_actors.device.data import EALData
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import AccessDeniedError, DataError, EALError, UnavailableError
from eal_actors.wire.format import keys
from eal_actors.wire.format.messages import Answer, Arguments, CallHeader, CallId, RobotTime, encode_call
from eal_actors.wire.rpc.client.clock_offset import ClockTracker
from eal_actors.wire.rpc.client.controller import Controller
from eal_actors.wire.rpc.client.value_memory import ValueMemory
from eal_actors.wire.rpc.freshness import Stamper
from eal_actors.wire.security.access import Rights

T = TypeVar("T")

CONNECTED: Final = (RobotState.READY, RobotState.FAILED)
"""States of a robot since its handshake; the robot's server outlives the robot's failure."""
_GRACE_S: Final = 1.0
"""Real seconds after a request's time-out by which its failure is reported."""

ReadReply = Callable[[Answer, RobotTime | None, float, float], T]
"""Reads an answer. Arguments: answer, robot's clock if included, our clock (REAL_TIME) at sending and at the reply."""
OnReply = Callable[[Answer | None, RobotTime | None, float, float], None]
"""The same, or is called without an answer if none will arrive."""


class SentCall(NamedTuple):
    """Call of a resource's method that was sent; commands have an identifier."""

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


class Channel:
    """Connection to one robot. Thread: any; nothing blocks.

    Attributes:
        inbox: mailbox and timers of the connection's actor.
        run_soon: runs an action in the thread of that actor, see EALActor.run_soon.
        stamper: numbers calls and stamps commands.
        pending: calls by their numbers, added before they are sent.
        rights: calls that the robot grants; None for all.
        process: the process that serves the robot, for batches; empty if it takes none.
    """

    def __init__(self, actor: EALActor, view: RobotView, controller: Controller) -> None:
        self.name: Final = view.name
        self.clock: Final = actor.clock
        self.inbox: Final = actor.actor_inbox
        self.run_soon: Final = actor.run_soon
        self.controller: Final = controller
        self.clock_tracker: Final = ClockTracker()
        self.stamper: Final = Stamper(controller.client)
        self.pending: Final[dict[int, SentCall | _Request]] = {}
        self.rights: Rights | None = None
        self.process = ""
        self.memory: Final = ValueMemory(self.run_soon, self.request, controller)
        self._view = view

    @property
    def is_ready(self) -> bool:
        """Whether the robot is reachable and the handshake is done; one that has failed answers calls too."""
        return self._view.state in CONNECTED and self.controller.is_alive(self.name)

    def denied(self, resource: str, method: str) -> str | None:
        """Return why the robot does not grant a method of a resource; None if it does."""
        return None if self.rights is None else self.rights.denied(resource, method)

    def _take_all(self) -> Iterator[SentCall | _Request]:
        for number in list(self.pending):
            if (call := self.pending.pop(number, None)) is not None:
                yield call

    def answer_all(self, answer: Answer, time: RobotTime | None) -> None:
        """Pass a reply to all pending calls: the robot could not decode the number of its call."""
        for call in self._take_all():
            call.answered(answer, time)

    def lose_all(self) -> None:
        """Report all pending calls as lost: the robot is unreachable."""
        for call in self._take_all():
            call.lost()

    def expire(self, now_s: float) -> None:
        """Report the pending calls whose time is over at a real time."""
        for number, call in list(self.pending.items()):
            if call.end_s <= now_s and self.pending.pop(number, None) is not None:
                call.timed_out()

    def to_robot_time(self, start_s: float | None, data: EALData | None) -> tuple[float | None, EALData | None]:
        """Return a start time and a value with its stamp, both by our fleet's clock, by the robot's clock instead.

        Raises UnavailableError if the robot has not replied yet.
        """
        if data is not None and data.stamp_s is not None:
            data = data.with_meta(stamp_s=self._robot_time(data.stamp_s))
        return None if start_s is None else self._robot_time(start_s), data

    def _robot_time(self, fleet_s: float) -> float:
        return self.clock.to_real(fleet_s) + self.clock_tracker.known().offset_s

    def call(self, method: str, arguments: Arguments, timeout_s: float, read: ReadReply[T]) -> Future[T]:
        """Call a method of the robot itself; `read` makes the future's value of the answer, in the reader's thread.

        The future fails with the robot's error, with AccessDeniedError if the robot does not grant the method, and
        with UnavailableError if no reply arrives.
        """
        future: Future[T] = Future(REAL_TIME, REAL_TIME.now() + timeout_s + _GRACE_S)
        run_later = self.controller.run_later

        def on_reply(answer: Answer | None, time: RobotTime | None, sent_s: float, answered_s: float) -> None:
            try:
                if answer is None:
                    raise UnavailableError("the robot did not answer")
                if isinstance(answer, EALError):
                    raise answer
                value = read(answer, time, sent_s, answered_s)
            except EALError as error:
                future.settle(None, error.at(self.name), run_later)
            else:
                future.settle(value, None, run_later)

        self._send(method, arguments, timeout_s, on_reply)
        return future

    def request(
        self,
        method: str,
        arguments: Arguments,
        timeout_s: float,
        on_answer: Callable[[Answer | None], None] = lambda _: None,
        resource: str = keys.ROBOT,
    ) -> None:
        """Call a method of the robot itself, or a stream.

        `on_answer` gets the answer, None if none will arrive, in the connection's thread.
        """

        def on_reply(answer: Answer | None, time: RobotTime | None, sent_s: float, answered_s: float) -> None:
            self.clock_tracker.note(time, sent_s, answered_s)
            self.run_soon(lambda: on_answer(answer))

        self._send(method, arguments, timeout_s, on_reply, resource)

    def _send(
        self, method: str, arguments: Arguments, timeout_s: float, on_reply: OnReply, resource: str = keys.ROBOT
    ) -> None:
        """Send a call; the callback runs in the reader's thread, or at once if the call is refused."""
        controller, stamper = self.controller, self.stamper
        try:
            if self.rights is not None:
                self.rights.check(resource, method)
            number, era, echo_s, held_s = stamper.number(), "", 0.0, 0.0
            if method == keys.RESUME:  # a late one would end a stop of which its caller knows nothing
                number, era, echo_s, held_s = stamper.stamp(REAL_TIME.now())
            about = stamper.client, stamper.epoch, number, timeout_s, timeout_s, None, arguments
            header = CallHeader(*about, era, echo_s, held_s)
            envelope, _ = encode_call(header)  # here, since an error would end the thread that sends
        except (AccessDeniedError, DataError, UnavailableError) as error:
            on_reply(error, None, 0.0, 0.0)
            return
        key = controller.call_key(self.name, resource, method)
        is_urgent = method in (keys.STOP, keys.RESUME)
        request = _Request(self, key, number, envelope, timeout_s, on_reply, is_urgent)
        if is_urgent:
            controller.send_urgently(request.send, request.bypass)
        elif not controller.sender.submit(request.send):
            request.lost()


@dataclass(eq=False)
class _Request:
    """Call of a method of the robot itself, with the clock readings that its reply needs.

    `timeout_s` is the time-out of the reply. `on_reply` is called with the answer in the reader's thread, or without
    one in any thread.
    """

    channel: Channel
    key: str
    number: int
    envelope: bytes
    timeout_s: float
    on_reply: OnReply
    is_urgent: bool
    _is_taken: threading.Lock = field(default_factory=threading.Lock, init=False)  # by the thread that sends it
    _sent_s: float = field(default=0.0, init=False)
    end_s: float = field(default=math.inf, init=False)

    def send(self, is_last: bool) -> None:
        if not self._is_taken.acquire(blocking=False):
            return
        channel = self.channel
        self._sent_s = REAL_TIME.now()
        self.end_s = self._sent_s + self.timeout_s
        channel.pending[self.number] = self
        controller = channel.controller
        if not self.is_urgent:
            controller.sender.flush()  # it must not overtake the calls before it
        if not controller.put(channel.name, self.key, self.envelope, b"", is_urgent=self.is_urgent, is_last=is_last):
            channel.lose_all()

    def bypass(self) -> None:
        if not self._is_taken.locked():
            self.channel.run_soon(lambda: self.send(True))

    def answered(self, answer: Answer, time: RobotTime | None) -> None:
        self.on_reply(answer, time, self._sent_s, REAL_TIME.now())

    def lost(self) -> None:
        self.on_reply(None, None, 0.0, 0.0)

    timed_out = lost
