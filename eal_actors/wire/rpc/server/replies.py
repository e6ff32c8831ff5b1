"""Replies: encodes the outcomes of a robot's calls and passes them on.

A reading has a way of its own, without the objects in between: it is by far the most frequent call.

Thread: any; nothing here blocks but `send`, as its caller chooses.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.device.data import EALData, Payload
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import BusyError, EALError, ResourceFaultError, error_text
from eal_actors.wire.format.messages import Answer, RobotTime, encode_reply, encode_status, encode_value
from eal_actors.wire.rpc.server.outbox import Outbox
from eal_actors.wire.rpc.server.running_commands import ReplyTo
from eal_actors.wire.shared_memory import LEAST_BYTES, ControllerMemories, SharedValue


class Replies:
    """Replies of one robot, in one run of its server."""

    def __init__(self, robot: RobotHandle, era: str, outbox: Outbox, memories: ControllerMemories) -> None:
        self._robot = robot.name
        self._clock = robot.clock
        self._era = era
        self._outbox = outbox
        self._memories = memories

    def outcome(self, done: Future[Any]) -> Answer:
        """Return the result of a finished call, with its stamp in real time."""
        value, error = done.outcome
        if error is not None:
            return error if isinstance(error, EALError) else ResourceFaultError(error_text(error))
        if type(value) is EALData and (stamp_s := value.stamp_s) is not None:
            return value.with_meta(stamp_s=self._clock.to_real(stamp_s))
        return 1 if value is None else value

    def answer(
        self,
        reply_to: ReplyTo,
        answer: Answer,
        *,
        began_s: float | None = None,
        send: Callable[..., None] | None = None,
        shared: SharedValue | None = None,
    ) -> None:
        """Reply to a call.

        `began_s` is when a command with a start time began, in real time. A value in shared memory is not sent. `send`
        is how to send it, as Outbox.publish, which is the default.
        """
        if type(answer) is int and began_s is None:  # the usual outcome of a command
            envelope = encode_status(reply_to.sequence, answer, self._era, REAL_TIME.now())
            self._send(reply_to, envelope, b"", send or self._outbox.publish)
            return
        time = tuple.__new__(RobotTime, (self._era, REAL_TIME.now(), began_s))
        if self._outbox.is_full and isinstance(answer, EALData) and shared is None:
            answer = BusyError("too many values wait for the network; read them less often", robot=self._robot)
        try:
            envelope, payload = encode_reply((reply_to.sequence, answer, time), shared)
        except EALError as error:  # too large, for example
            envelope, payload = encode_reply((reply_to.sequence, error.at(self._robot), time))
        self._send(reply_to, envelope, payload, send or self._outbox.publish)

    def _send(self, reply_to: ReplyTo, envelope: bytes, payload: Payload, send: Callable[..., None]) -> None:
        key, _, is_urgent, batch, link = reply_to
        if link is not None and link.send(self._robot, envelope, payload):
            return
        if batch is None or is_urgent or not batch.add(self._robot, envelope, payload):
            send(key, envelope, payload, is_urgent=is_urgent)

    def answer_reading(
        self, reply_to: ReplyTo, client: str, send: Callable[..., None], done: Future[Any], _: object
    ) -> None:
        """Reply to a call that changes nothing; its value may be handed over in shared memory.

        `send` is how to send it, as Outbox.publish. A relay has the last two arguments: the call is done.
        """
        value = done.outcome[0]
        if type(value) is EALData and value.length < LEAST_BYTES and not self._outbox.is_full:  # the usual case
            stamp_s = None if value.stamp_s is None else self._clock.to_real(value.stamp_s)
            try:
                envelope = encode_value(reply_to.sequence, value, stamp_s, self._era, REAL_TIME.now())
            except EALError as error:
                self.answer(reply_to, error.at(self._robot))
            else:
                self._send(reply_to, envelope, value.payload, send)
            return
        answer, shared = self.outcome(done), None
        if type(answer) is EALData and answer.length >= LEAST_BYTES:
            shared = self._memories.put(client, answer.payload)
        self.answer(reply_to, answer, send=send, shared=shared)
