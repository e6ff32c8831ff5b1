"""Lane: the calls to one robot on the network, from their callers to its answers.

Calls wait here in the order of their making until the fleet's sender gives the lane its turn, and are stamped as they
leave, so that waiting does not make them stale; one that is made while no other is under way leaves at once. What
stops something goes past everything that waits, and no other robot's stalled link can hold it up: then the thread of
the robot's own connection sends it. Answers are concluded in zenoh's threads, which wake those that wait for them and
leave callbacks to the controller.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Final, NoReturn

from eal_actors.actors.actor import Envelope
from eal_actors.actors.call import Call
from eal_actors.device.data import EALData
from eal_actors.device.resource import Progress
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import BusyError, EALError, ProtocolError, RemoteError, UnavailableError
from eal_actors.net import keys
from eal_actors.net.calling import READS, is_small, split_arguments
from eal_actors.net.connection import Connection
from eal_actors.net.controller import Controller
from eal_actors.net.exchange import AskedCall, Exchanges
from eal_actors.net.receipts import Stamper
from eal_actors.net.rights import Rights
from eal_actors.net.sender import UrgentMessage
from eal_actors.net.stamps import translated
from eal_actors.net.timing import fleet_time_of, real_time_of
from eal_actors.net.wire import ACCEPTED, Answer, CallHeader, CallId, Event, Reply, RobotTime, encode_call

TTL_S: Final = 1.0
"""How old a command may be when a robot begins it, in real seconds."""

MOST_UNDER_WAY: Final = 256
"""Calls to one robot that wait to be sent or answered; further ones are refused. Urgent ones may be as many more."""

_RETRY_S: Final = 0.05
_BACK_S: Final = 1.0
"""Real seconds in which a robot that went may come back and be asked again what it was asked."""
_REATTACH_S: Final = 2.0
_ASK_EACH_S: Final = 1.0, 8.0
"""Real seconds between two questions for commands that take long: first, and most."""


class Lane(UrgentMessage):
    """The calls to one robot; a resource's slot takes it for the resource's actor, and it is its own mailbox.

    Args:
        robot: the connection to the robot.
        controller: the fleet's end of the network.

    Attributes:
        rights: what may be called, as the robot told; None for everything.
        exchanges: what is not answered yet.
        pace: of the calls to all robots.

    Thread: any, but for what says otherwise.
    """

    def __init__(self, robot: Connection, controller: Controller) -> None:
        self._robot = robot
        self._controller = controller
        self.pace: Final = controller.pace
        self._stamper = Stamper(controller.client)
        self._lock = threading.Lock()
        self._urgent: deque[Call[Any]] = deque()
        self._normal: deque[Call[Any]] = deque()
        self._under_way: set[Call[Any]] = set()
        self._end: EALError | None = None
        self._sending = threading.Lock()
        self._running: dict[CallId, Call[Any]] = {}
        self._told: tuple[RobotTime, float] | None = None
        self.exchanges: Final = Exchanges()
        self.rights: Rights | None = None
        self._ask_at_s = math.inf
        self._doubted: set[CallId] = set()
        self._ask_each_s = _ASK_EACH_S[0]

    # As the target of calls; see CallTarget and Mailbox.

    @property
    def actor_inbox(self) -> Lane:
        """See CallTarget."""
        return self

    @property
    def resource(self) -> NoReturn:
        """The resource itself is in another process (Source: thesis §4.5).

        Raises:
            RemoteError: always.
        """
        raise RemoteError("the resource itself cannot be had through a network", robot=self._robot.name)

    def put(self, envelope: Call[Any]) -> None:
        """Add a call.

        Raises:
            AccessDeniedError: the robot does not grant it.
            BusyError: too many are under way.
            UnavailableError: the connection has ended.
        """
        with self._lock:
            self._admit(envelope, MOST_UNDER_WAY)
            self._normal.append(envelope)
        is_alone = self.pace.is_idle and self._controller.sender.is_idle  # it waits for no link and overtakes nothing
        if is_alone and is_small(envelope) and self._sending.acquire(blocking=False):
            try:
                self._send_next(is_last=True)
            finally:
                self._sending.release()
        else:
            self._controller.sender.submit(self)

    def put_urgent(
        self, envelope: Call[Any], *, bounded: bool = True, drop: Callable[[Envelope], bool] | None = None
    ) -> list[Envelope]:
        """Add a call that goes first; see Inbox.

        Raises:
            AccessDeniedError: the robot does not grant it.
            BusyError: too many are under way.
            UnavailableError: the connection has ended.
        """
        dropped: list[Envelope] = []
        with self._lock:
            self._admit(envelope, 2 * MOST_UNDER_WAY if bounded else math.inf)
            if drop is not None and self._normal:
                dropped = [call for call in self._normal if drop(call)]
                self._normal = deque(call for call in self._normal if not drop(call))
                self._under_way.difference_update(dropped)
            self._urgent.append(envelope)
        if envelope.stops:
            self._controller.urge(self)
        else:
            self._controller.sender.submit(self)
        return dropped

    def _admit(self, call: Call[Any], most: float) -> None:
        if self._end is not None:
            raise self._end.copy()
        if self.rights is not None:
            self.rights.check(call.cell.name, call.method)
        if len(self._under_way) >= most:
            raise BusyError(f"{most:g} calls to the robot are under way already")
        self._under_way.add(call)

    def stop_activity_of(self, call: Call[Any]) -> None:
        """See CallTarget."""
        with self._lock:
            if call in self._normal:  # it has not left, and takes nobody's place
                self._normal.remove(call)
                self._under_way.discard(call)
                return
        if call.method not in READS:
            self._robot.soon(lambda: self._cancel(call))

    def _cancel(self, call: Call[Any]) -> None:
        """Have a command given up. Thread: the connection's."""
        with self._sending:  # it has left by now, or never will
            mine = [call_id for call_id, running in list(self._running.items()) if running is call]
        for call_id in mine:
            self._running.pop(call_id, None)
            self._robot.ask_robot(keys.CANCEL, (call_id.epoch, call_id.sequence), TTL_S)

    # Sending.

    def send(self, *, is_last: bool) -> None:
        """Send the call whose turn it is; see Message."""
        with self._sending:
            self._send_next(is_last=is_last)

    def _send_next(self, *, is_last: bool) -> None:
        with self._lock:
            waiting = self._urgent or self._normal
            call = waiting.popleft() if waiting else None
        if call is not None:
            self._send(call, is_last=is_last)

    def insist(self) -> None:
        """See UrgentMessage."""
        if self._urgent:
            self._robot.soon(self._send_urgent)

    def _send_urgent(self) -> None:
        """Send what is urgent and still waits. Thread: the connection's."""
        with self._sending:
            while self._urgent:
                self._send(self._urgent.popleft(), is_last=True)

    def _send(self, call: Call[Any], *, is_last: bool) -> None:
        clock = self._robot.clock
        left_s = (call.deadline_s or 0.0) - clock.now()
        if call.stops:
            left_s = max(left_s, call.cell.timeout_s)
        elif call.done():
            self._under_way.discard(call)
            return
        elif left_s <= 0:
            self._under_way.discard(call)
            self._controller.later(call.expire)
            return
        try:
            header, data = self._header(call, left_s, has_more=not is_last)
            envelope, payload = encode_call(header, data)
        except EALError as error:
            self._under_way.discard(call)
            call.settle(None, error.at(self._robot.name, call.cell.name), self._controller.later)
            return
        if call.method not in READS and call.method != keys.HALT:
            self._running[header.call_id] = call
        if call.span is not None:
            call.span.note("sent")
        end_s = REAL_TIME.now() + left_s / clock.of_real(1.0)
        self.exchanges.open(header.sequence, AskedCall(self, call, header.call_id, end_s))
        self.pace.sent()
        key = self._controller.call_key(self._robot.name, call.cell.name, call.method)
        if not self._controller.put(self._robot.name, key, envelope, payload, is_urgent=call.stops, is_last=is_last):
            self.exchanges.lose()

    def _header(self, call: Call[Any], left_s: float, *, has_more: bool) -> tuple[CallHeader, EALData | None]:
        """Return how a call is announced; commands, and what stops them, have a number and proof of their age."""
        plain, data = split_arguments(call)
        stamper = self._stamper
        traceparent = "" if call.span is None else call.span.traceparent
        if call.method in READS:
            number = stamper.number()
            head = CallHeader(
                stamper.client, stamper.epoch, number, left_s, left_s, None, plain, traceparent=traceparent
            )
            return head, data
        start_s = None if call.start_s is None else self._time_on_robot(call.start_s)
        if data is not None and data.stamp_s is not None:
            data = data.with_meta(stamp_s=self._time_on_robot(data.stamp_s))
        told, self._told = self._told, None
        if told is not None:
            time, told_s = told
            stamper.heard(time.era, time.time_s, told_s)
        stamp = stamper.stamp(TTL_S, REAL_TIME.now())
        echo = stamp.era, stamp.echo_s, stamp.held_s
        return CallHeader(*stamp.call, TTL_S, left_s, start_s, plain, *echo, has_more, traceparent), data

    def number(self) -> int:
        """Return the number of a call that is no command."""
        return self._stamper.number()

    def _time_on_robot(self, fleet_s: float) -> float:
        real_s = real_time_of(self._robot.clock, fleet_s)
        return real_s + self._robot.pinger.offset(real_s).offset_s

    # Answers.

    def hear_reply(self, reply: Reply) -> None:
        """Take in an answer, and the robot's clock for the next stamp. Thread: zenoh's."""
        if reply.time is not None:
            self._told = reply.time, REAL_TIME.now()
        if not self.exchanges.answer(reply):  # a robot that leaves may tell the outcome behind its sign of life
            for call_id, call in list(self._running.items()):
                if call_id.sequence == reply.sequence:
                    self.conclude(call, call_id, reply.answer, reply.time)

    def conclude(self, call: Call[Any], call_id: CallId, answer: Answer, time: RobotTime | None) -> None:
        """Give a call its outcome, unless it goes on. Thread: zenoh's."""
        self._under_way.discard(call)
        if answer is ACCEPTED:
            if call_id in self._running:
                self._ask_at_s = math.inf  # `look` begins anew
                return
            answer = ProtocolError("the robot has accepted a call that cannot take long")
        self._running.pop(call_id, None)
        if time is not None:
            if time.began_s is not None and call.start_s is not None:
                self._note_begin(call, time.began_s)
            if isinstance(answer, EALData) and answer.stamp_s is not None:
                answer, call.stamp_error_s = translated(answer, time, self._robot.pinger, self._robot.clock)
        later = self._controller.later
        if isinstance(answer, EALError):
            call.settle(None, answer.at(self._robot.name, call.cell.name), later)
        else:
            call.settle(answer, None, later)

    def hear(self, event: Event) -> None:
        """Take in the outcome of a command that went on. Thread: zenoh's."""
        call = self._running.get(event.call) if event.call is not None else None
        if call is not None and event.answer is not None and event.call is not None:
            began_s = event.fields.get("began_s")
            time = RobotTime("", event.stamp_s, began_s if isinstance(began_s, float) else None)
            self.conclude(call, event.call, event.answer, time)

    def hear_progress(self, call_id: CallId, progress: Progress) -> None:
        """Take in how far a command has come, by our fleet's clock. Thread: zenoh's."""
        call = self._running.get(call_id)
        if call is not None:
            call.note_progress(progress, self._controller.later)

    def _note_begin(self, call: Call[Any], began_s: float) -> None:
        """Take in when a command began by the robot's clock, and how well that is known by ours."""
        clock = self._robot.clock
        offset = self._robot.pinger.offset(REAL_TIME.now())
        call.began_s = fleet_time_of(clock, began_s - offset.offset_s)
        call.began_error_s = clock.of_real(offset.error_s)

    def miss(self, call: Call[Any], call_id: CallId) -> None:
        """The robot is not there to answer: what only reads is asked again, a command never. Thread: any."""
        clock = self._robot.clock
        back_by_s = clock.now() + clock.of_real(_BACK_S)
        self._robot.soon(lambda: self._miss(call, call_id, back_by_s))

    def expire(self, call: Call[Any]) -> None:
        """The deadline of a call has passed without an answer. Thread: any."""
        self._under_way.discard(call)
        self._controller.later(call.expire)

    def _miss(self, call: Call[Any], call_id: CallId, back_by_s: float) -> None:
        robot, now_s = self._robot, self._robot.clock.now()
        if call.done():
            self._under_way.discard(call)
            self._running.pop(call_id, None)
        elif call_id in self._running:  # it is asked after once the robot is back
            self._under_way.discard(call)
        elif now_s >= (call.deadline_s or 0.0):
            self.expire(call)
        elif now_s >= back_by_s:
            self._under_way.discard(call)
            call.fail(UnavailableError("the robot did not answer"))
        else:
            again = self._put_again if robot.is_ready else lambda it: self._miss(it, call_id, back_by_s)
            robot.actor_inbox.call_later(robot.clock.of_real(_RETRY_S), lambda: again(call))

    def _put_again(self, call: Call[Any]) -> None:
        try:
            (self.put_urgent if call.stops else self.put)(call)
        except EALError as error:
            call.fail(error)

    # The connection. Thread: its own.

    def renumber(self) -> int:
        """Begin a new epoch: the robot has come back, and is to refuse what is still on its way. Returns it."""
        with self._sending:
            self._stamper.reconnect()
            return self._stamper.epoch

    def look(self, now_s: float) -> None:
        """Give up what has no time left, and ask for commands that take long, for their outcome may get lost.

        Thread: the controller's.
        """
        self.exchanges.look(now_s)
        if not self._running:
            self._ask_at_s = math.inf
        elif self._ask_at_s == math.inf:
            self._ask_each_s = _ASK_EACH_S[0]
            self._ask_at_s = now_s + self._ask_each_s
        elif now_s >= self._ask_at_s:
            self._ask_each_s = min(2 * self._ask_each_s, _ASK_EACH_S[1])
            self._ask_at_s = now_s + self._ask_each_s
            if self._robot.is_ready:
                self._robot.soon(self.reattach)

    def reattach(self) -> None:
        """Ask what has become of commands whose answer did not come."""
        mine = [call_id for call_id, call in list(self._running.items()) if not call.done()]
        if mine:
            numbers = tuple(number for call_id in mine for number in (call_id.epoch, call_id.sequence))
            self._robot.ask_robot(keys.REATTACH, numbers, _REATTACH_S, self._forget_unknown)

    def _forget_unknown(self, answer: Answer) -> None:
        if not isinstance(answer, dict):
            return
        unknown = {CallId(self._controller.client, *numbers) for numbers in answer.get("unknown", ())}
        doubted, self._doubted = self._doubted & unknown, unknown - self._doubted
        if self._doubted:  # the question may have overtaken them: only what is unknown twice is lost
            self._ask_at_s = -math.inf
        for call_id in doubted:
            call = self._running.pop(call_id, None)
            if call is not None:
                call.fail(UnavailableError("the robot knows nothing of it: it was lost, or the robot was restarted"))

    def close(self, error: EALError) -> None:
        """Fail whatever is under way, and take nothing more."""
        with self._lock:
            self._end = error
            calls = {*self._under_way, *self._running.values()}
            for waiting in (self._under_way, self._running, self._normal, self._urgent):
                waiting.clear()
        for call in calls:
            call.fail(error.copy())
        self.exchanges.lose()
