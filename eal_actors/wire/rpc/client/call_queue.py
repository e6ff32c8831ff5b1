"""CallQueue: the outgoing calls to one remote robot, from their callers to the robot's replies.

Calls wait here in the order of submission until the fleet's sender gives the queue its turn. They are stamped when they
are sent, so that waiting does not make them stale. A small call is sent at once, in the caller's thread, while no call
is in flight: then it waits for no link and overtakes no other call. A stop overtakes all waiting calls, and no other
robot's stalled link can delay it: after a moment the thread of the robot's own connection sends it. Replies are handled
in the thread that reads them, which resolves futures and leaves callbacks to the controller.
"""

from __future__ import annotations

import threading
from collections import defaultdict, deque
from collections.abc import Callable
from typing import Any, Final, NoReturn

from eal_actors.actors.call import Call
from eal_actors.actors.inbox import Envelope
from eal_actors.device.data import EALData, Payload
from eal_actors.device.resource import Progress
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import BusyError, EALError, ProtocolError, RemoteError, UnavailableError
from eal_actors.wire.format import keys
from eal_actors.wire.format.messages import (
    ACCEPTED,
    NO_PROOF,
    Answer,
    CallId,
    RobotEvent,
    RobotTime,
    decode_reply,
    encode_fields,
)
from eal_actors.wire.rpc.call_arguments import is_action, is_small, split_arguments
from eal_actors.wire.rpc.client.call_sender import EncodedCall
from eal_actors.wire.rpc.client.channel import Channel, SentCall
from eal_actors.wire.rpc.client.command_tracking import CommandTracker
from eal_actors.wire.shared_memory import LEAST_BYTES

AT_ONCE: Final = 128
"""Calls in flight from which on callers of a robot with a local link leave their calls to the sender, which then waits
for replies: so few small ones always have room in the link, and a caller that sends waits for nothing."""

_TTL_S: Final = dict.fromkeys((*keys.COMMANDS, keys.HALT), 1.0)
"""Time to live of a command: its greatest age when the robot begins it, in real seconds; of others their deadline."""

_NO_VALUE: Final = (), (None,)
"""Ends of the arguments of most calls."""
_RETRY_S: Final = 0.05
_RECONNECT_S: Final = 1.0
"""Real seconds within which a lost robot may come back and be asked again."""


class CallQueue:
    """Outgoing calls to one robot. It takes the place of the resources' actors and their mailboxes.

    `capacity` limits the pending calls to one resource. `tracker` has our commands whose outcome has not arrived,
    `window` the calls in flight to all robots. Thread: any, unless noted.
    """

    def __init__(self, channel: Channel, capacity: int) -> None:
        self._channel = channel
        self._lose_all = channel.lose_all
        self._pending, self._heard = channel.pending, channel.stamper.heard
        self._name = channel.name
        self._controller = channel.controller
        self._second = channel.clock.of_real(1.0)
        self._is_proven = channel.controller.certificate is not None
        self._sender = channel.controller.sender
        self._links = channel.controller.local.links
        self.window: Final = self._sender.window
        self._lock = threading.Lock()
        self._urgent: deque[Call[Any]] = deque()
        self._normal: deque[Call[Any]] = deque()
        self._capacity = capacity
        self._unanswered = defaultdict[str, set[Call[Any]]](set)  # by resource: a frozen one makes no other busy
        self._keys: dict[tuple[str, str], str] = {}  # of calls, by resource and method
        self._end: EALError | None = None
        self._sending = threading.Lock()
        self.tracker: Final = CommandTracker(channel)

    # CallServer.

    @property
    def resource(self) -> NoReturn:
        """Raise RemoteError: the resource object is in another process (Source: thesis §4.5)."""
        raise RemoteError("the resource itself is not available over a network", robot=self._channel.name)

    def put(self, envelope: Call[Any]) -> None:
        """Add a call.

        Raises AccessDeniedError if the robot does not grant it, BusyError if too many calls to its resource are
        pending, and UnavailableError if the connection has ended.
        """
        with self._lock:
            if self._end is not None or self._channel.rights is not None:
                self._admit(envelope)
            unanswered, sender = self._unanswered[envelope.cell.name], self._sender
            if len(unanswered) >= self._capacity:
                raise BusyError(f"{self._capacity} calls are pending already")
            unanswered.add(envelope)
            in_flight = self.window.calls
            sends = (
                not (self._normal or self._urgent or sender.unsent)
                and (not in_flight or (self._name in self._links and len(in_flight) < AT_ONCE))
                and not sender.has_crowd
                and (envelope.arguments[-1:] in _NO_VALUE or is_small(envelope))
                and self._sending.acquire(blocking=False)
            )
            if not sends:
                self._normal.append(envelope)
        if not sends:
            sender.submit(self._send_next)
            return
        try:
            self._send(envelope)
        finally:
            self._sending.release()

    def put_urgent(
        self, envelope: Call[Any], *, bounded: bool = True, drop: Callable[[Envelope], bool] | None = None
    ) -> list[Envelope]:
        """Add a call before all others, and return the calls that `drop` removes; see Inbox. Raises as `put`."""
        dropped: list[Envelope] = []
        with self._lock:
            self._admit(envelope)
            unanswered, most = self._unanswered[envelope.cell.name], 2 * self._capacity
            if bounded and len(unanswered) >= most:
                raise BusyError(f"{most} calls are pending already")
            unanswered.add(envelope)
            if drop is not None and self._normal:
                for call in [call for call in self._normal if drop(call)]:
                    self._normal.remove(call)
                    self._forget(call)
                    dropped.append(call)
            self._urgent.append(envelope)
        if envelope.stops:
            self._controller.send_urgently(self._send_next, self._bypass)
        else:
            self._sender.submit(self._send_next)
        return dropped

    def _admit(self, call: Call[Any]) -> None:
        if self._end is not None:
            raise self._end.copy()
        if self._channel.rights is not None:
            self._channel.rights.check(call.cell.name, call.method)

    def stop_activity_of(self, call: Call[Any]) -> None:
        """Drop a call that nobody waits for, or cancel its command on the robot."""
        with self._lock:
            if call in self._normal:
                self._normal.remove(call)
                self._forget(call)
                return
        if not _is_reading(call):
            self._channel.run_soon(lambda: self._cancel(call))

    def _cancel(self, call: Call[Any]) -> None:
        with self._sending:  # from now on it is either sent or never will be
            self.tracker.cancel(call)

    # Sending.

    def _send_next(self, is_last: bool) -> None:
        with self._sending:
            with self._lock:
                waiting = self._urgent or self._normal
                call = waiting.popleft() if waiting else None
            if call is None:
                return
            if call.stops or self._name in self._links:
                self._send(call)
            elif (encoded := self._encode(call)) is not None:
                # Access control checks the key alone, so calls with other keys are not put behind it.
                process, key = self._channel.process, encoded[2]
                group = key if self._is_proven and process else process
                # Named tuples are made by tuple.__new__ here: their own takes several times as long.
                about = self._name, call.cell.name, call.method, *encoded, group, self._lose_all
                self._sender.gather(tuple.__new__(EncodedCall, about), is_last=is_last)

    def _bypass(self) -> None:
        if self._urgent:
            self._channel.run_soon(self._send_urgent)

    def _send_urgent(self) -> None:
        """Send the urgent calls that still wait. Thread: the connection's."""
        with self._sending:
            while self._urgent:
                self._send(self._urgent.popleft())

    def _send(self, call: Call[Any]) -> None:
        """Send a call in a message of its own. Thread: one that may wait for a link, unless the call is small."""
        encoded = self._encode(call)
        if encoded is None:
            return
        envelope, payload, key = encoded
        link = self._links.get(self._name)
        if link is not None and link.send(key, envelope, payload):
            is_sent = self._controller.is_alive(self._name)  # it may have gone before the call was pending
        else:
            is_sent = self._controller.put(self._name, key, envelope, payload, is_urgent=call.stops)
        if not is_sent:
            self._lose_all()

    def _encode(self, call: Call[Any]) -> tuple[bytes, Payload, str] | None:
        """Return a call's envelope, payload and key, and wait for its reply from now on; None if it is over."""
        channel, name, method, span = self._channel, call.cell.name, call.method, call.span
        now_s = REAL_TIME.now()  # before the fleet's clock, so that the seconds left never end after the deadline
        left_s = (call.deadline_s or 0.0) - channel.clock.now()
        if call.stops:  # a late stop is still a stop
            left_s = max(left_s, call.cell.timeout_s)
        elif left_s <= 0 or call.done():
            self.expire(call)
            return None
        left_s /= self._second
        call_id: CallId | None = None
        start_s, stamper = call.start_s, channel.stamper
        try:
            plain, data = split_arguments(call) if call.arguments else ((), None)
            if _is_reading(call):
                number, ttl_s, proof = stamper.number(), left_s, NO_PROOF
            else:
                number, era, echo_s, held_s = stamper.stamp(now_s)
                call_id = tuple.__new__(CallId, (stamper.client, stamper.epoch, number))
                ttl_s, proof = _TTL_S.get(method, left_s), (era, echo_s, held_s, "")
                if data is not None or start_s is not None:
                    start_s, data = channel.to_robot_time(start_s, data)
            if span is not None:
                proof = *proof[:3], span.traceparent
            envelope, payload = encode_fields(
                stamper.client, stamper.epoch, number, ttl_s, left_s, start_s, plain, proof, data
            )
        except EALError as error:
            self._forget(call)
            call.settle(None, error.at(channel.name, name), self._controller.run_later)
            return None
        if call_id is not None and method != keys.HALT:
            self.tracker.commands[call_id] = call
        if span is not None:
            span.note("sent")
        self._pending[number] = tuple.__new__(SentCall, (self, call, call_id, now_s + left_s))
        self.window.calls.add(call)
        key = self._keys.get((name, method))
        if key is None:
            key = self._keys[name, method] = self._controller.call_key(self._name, name, method)
        return envelope, payload, key

    # Replies and events. Thread: a reader's.

    def receive_reply(self, envelope: bytes, payload: bytes) -> None:
        """Handle a reply, and keep the robot's clock for the next stamp."""
        memory = self._channel.memory
        if len(payload) >= LEAST_BYTES:
            memory.note(len(payload))
        try:
            sequence, answer, time = decode_reply(envelope, payload, memory.take)
        except ProtocolError as error:
            sequence, answer, time = 0, error, None
        if time is not None:
            self._heard(time.era, time.time_s, REAL_TIME.now())
        pending = self._pending.pop(sequence, None)
        if type(pending) is SentCall:
            self.conclude(pending.call, pending.call_id, answer, time)
        elif pending is not None:
            pending.answered(answer, time)
        elif sequence == 0:
            self._channel.answer_all(answer, time)
        else:  # a leaving robot may send the outcome after its token has gone
            for call_id, call in list(self.tracker.commands.items()):
                if call_id.sequence == sequence:
                    self.conclude(call, call_id, answer, time)

    def receive_result(self, event: RobotEvent) -> None:
        """Handle the outcome of a long command."""
        call_id, answer, began_s = event.call, event.answer, event.fields.get("began_s")
        if call_id is not None and answer is not None and (call := self.tracker.commands.get(call_id)) is not None:
            time = RobotTime("", event.stamp_s, began_s if isinstance(began_s, float) else None)
            self.conclude(call, call_id, answer, time)

    def receive_progress(self, call_id: CallId, progress: Progress) -> None:
        """Handle the progress of a command; its time is by our fleet's clock."""
        call = self.tracker.commands.get(call_id)
        if call is not None:
            call.note_progress(progress, self._controller.run_later)

    def conclude(self, call: Call[Any], call_id: CallId | None, answer: Answer, time: RobotTime | None) -> None:
        """Resolve a call, unless the robot has only accepted it."""
        self._unanswered[call.cell.name].discard(call)  # as _forget, in every call
        if answer is ACCEPTED:
            if call_id in self.tracker.commands:
                self.tracker.restart_backoff()
                self.window.answered(call)
                return
            answer = ProtocolError("the robot has accepted a call that cannot take long")
        if call_id is not None:
            self.tracker.commands.pop(call_id, None)
        if time is not None:
            clocks, clock = self._channel.clock_tracker, self._channel.clock
            if time.began_s is not None and call.start_s is not None:
                known = clocks.known()
                call.began_s = clock.from_real(time.began_s - known.offset_s)
                call.began_error_s = clock.of_real(known.error_s(REAL_TIME.now()))
            if type(answer) is EALData and (stamp_s := answer.stamp_s) is not None:
                call.stamp_error_s = clocks.localize(answer, stamp_s, time, clock)
        if isinstance(answer, EALError):
            call.settle(None, answer.at(self._channel.name, call.cell.name), self._controller.run_later)
        else:
            call.settle(answer, None, self._controller.run_later)
        self.window.answered(call)  # after the caller is woken, whose next call may go with the next message

    # Failures. Thread: any.

    def _forget(self, call: Call[Any]) -> None:
        self._unanswered[call.cell.name].discard(call)

    def lose(self, call: Call[Any], call_id: CallId | None) -> None:
        """Retry a call whose robot is unreachable if it changes nothing; a command is never sent twice."""
        clock = self._channel.clock
        retry_until_s = clock.now() + clock.of_real(_RECONNECT_S)
        self._channel.run_soon(lambda: self._retry(call, call_id, retry_until_s))

    def expire(self, call: Call[Any]) -> None:
        """Fail a call whose deadline has passed without a reply."""
        self._forget(call)
        self._controller.run_later(call.expire)

    def _retry(self, call: Call[Any], call_id: CallId | None, retry_until_s: float) -> None:
        channel, now_s = self._channel, self._channel.clock.now()
        if call.done():
            self._forget(call)
            if call_id is not None:
                self.tracker.commands.pop(call_id, None)
        elif call_id in self.tracker.commands:  # the robot is asked for its outcome after the reconnect
            self._forget(call)
        elif now_s >= (call.deadline_s or 0.0):
            self.expire(call)
        elif now_s >= retry_until_s:
            self._forget(call)
            call.fail(UnavailableError("the robot did not answer"))
        else:
            again = self._put_again if channel.is_ready else lambda it: self._retry(it, call_id, retry_until_s)
            channel.inbox.call_later(channel.clock.of_real(_RETRY_S), lambda: again(call))

    def _put_again(self, call: Call[Any]) -> None:
        try:
            (self.put_urgent if call.stops else self.put)(call)
        except EALError as error:
            call.fail(error)

    # The connection.

    def begin_epoch(self) -> None:
        """Begin a new epoch after a reconnect: the robot refuses commands of earlier ones. Thread: the connection's."""
        with self._sending:
            self._channel.stamper.reconnect()

    def tick(self, now_s: float) -> None:
        """Fail calls whose time is over, and ask for missing outcomes. Thread: the controller's."""
        self._channel.expire(now_s)
        self.tracker.tick(now_s)

    def close(self, error: EALError) -> None:
        """Fail all calls, and refuse new ones. Thread: the connection's."""
        commands = self.tracker.commands
        with self._lock:
            self._end = error
            calls = {*commands.values()}.union(*self._unanswered.values())
            for waiting in (commands, self._unanswered, self._normal, self._urgent):
                waiting.clear()
        for call in calls:
            call.fail(error.copy())
        self._lose_all()


def _is_reading(call: Call[Any]) -> bool:
    """Return whether a call changes nothing, so that it may be repeated."""
    if call.method == "send_req":
        return not is_action(call.cell.info, call.arguments)
    return call.method in keys.RETRYABLE_METHODS
