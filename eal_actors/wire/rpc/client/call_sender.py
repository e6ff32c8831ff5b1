"""CallSender: sends the calls to all robots, those that wait together to one process in one message.

A caller that is alone sends its own call. All others leave theirs to the sender, which takes what has gathered while
the calls before were answered, at most for PAUSE_S: the more callers, the larger the batches. (Without the pause, eight
callers settle into three groups that follow one another.)

InFlightWindow limits how far calls run ahead of their replies. A process that serves a thousand robots takes their
commands one by one; commands that wait in its socket age, and a command that is too old is refused. So the sender
waits while many calls are unanswered, but only as long as replies arrive: a long command is answered late, and a
frozen robot never answers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

from typing_extensions import override

from eal_actors.device.data import Payload
from eal_actors.kernel.clock import REAL_TIME, new_waiter
from eal_actors.wire.format.batches import MAX_BATCH_BYTES, MAX_ROW_BYTES, MAX_ROWS, encode_batch
from eal_actors.wire.rpc.sender import Sender

WINDOW: Final = 256
"""Unanswered calls at which the sender waits."""

_RESUME_AT: Final = 128
"""Unanswered calls at which it continues: sending many together costs less than one by one."""

PATIENCE_S: Final = 0.05
"""Real seconds without a reply after which the calls in flight count as slow and no longer block the sender."""

PAUSE_S: Final = 0.001
"""Real seconds that the sender waits for replies at most, while calls gather."""


class InFlightWindow:
    """The unanswered calls of one session, which are added before they are sent.

    Thread: any, except for the methods that wait. A set needs no lock for that.
    """

    def __init__(self) -> None:
        self.calls: Final = set[object]()
        self._slow = 0
        self._resume_at: int | None = None  # calls in flight at which the waiting sender is woken
        self._waiter = new_waiter()

    @property
    def is_full(self) -> bool:
        """Whether the sender has to wait."""
        return len(self.calls) - self._slow >= WINDOW

    def answered(self, call: object) -> None:
        """Note that a call is answered or has failed."""
        self.calls.discard(call)
        if self._slow or self._resume_at is not None:
            self._slow = min(self._slow, len(self.calls))
            resume_at = self._resume_at
            if resume_at is not None and len(self.calls) - self._slow <= resume_at:
                REAL_TIME.wake(self._waiter)

    def wait_for_room(self) -> None:
        """Wait until fewer calls are in flight. Thread: the sender's; blocks as long as replies arrive."""
        while (in_flight := len(self.calls)) - self._slow > _RESUME_AT:
            if not self._wait(_RESUME_AT, PATIENCE_S) and len(self.calls) >= in_flight:
                self._slow = len(self.calls)

    def wait_for_replies(self) -> None:
        """Wait a moment until every call is answered. Thread: the sender's; blocks for PAUSE_S at most."""
        if len(self.calls) > self._slow and not self._wait(0, PAUSE_S):
            self._slow = len(self.calls)

    def _wait(self, resume_at: int, patience_s: float) -> bool:
        self._resume_at = resume_at  # before the look at the calls, so that no answer in between is missed
        is_woken = len(self.calls) - self._slow <= resume_at or REAL_TIME.wait(self._waiter, patience_s)
        self._resume_at = None
        return is_woken


class EncodedCall(NamedTuple):
    """A call that is ready to be sent. Calls of one group may be sent together; one without a group goes alone.

    `lose_all` is called if it cannot be sent: the calls to its robot get no replies.
    """

    robot: str
    resource: str
    method: str
    envelope: bytes
    payload: Payload
    key: str
    group: str
    lose_all: Callable[[], None]


class CallSender(Sender):
    """Sends calls in the order of their submission.

    `put` sends one message to a robot, see Controller.put. `has_crowd` is whether the last message that was sent from
    here had several calls.

    Thread: an actor; any may call `submit`. `gather` and `flush` belong to its own thread, which may wait for a link.
    """

    def __init__(self, name: str, put: Callable[..., bool], is_alive: Callable[[str], bool]) -> None:
        super().__init__(name)
        self._put = put
        self._is_alive = is_alive
        self.window: Final = InFlightWindow()
        self._gathered: dict[str, list[EncodedCall]] = {}  # by group
        self._bytes = 0
        self._is_gathering = False
        self.has_crowd = False

    @override
    def send_next(self) -> None:
        if not self._is_gathering:
            self.window.wait_for_replies()
            self._is_gathering = True
        if self.window.is_full:
            self.flush()
            self.window.wait_for_room()
        is_last = self.actor_inbox.empty()
        self.unsent[0](is_last)
        self.unsent.popleft()
        if is_last:
            self.flush()
            self._is_gathering = False

    def gather(self, call: EncodedCall, *, is_last: bool) -> None:
        """Send a call with those before it, at the latest when no message waits; the last one has none behind it."""
        size = len(call.envelope) + len(call.payload)
        if not call.group or size > MAX_ROW_BYTES:
            self.flush()
            self._send([call], is_last=is_last)
            return
        gathered = self._gathered.setdefault(call.group, [])
        gathered.append(call)
        self._bytes += size
        if len(gathered) >= MAX_ROWS or self._bytes >= MAX_BATCH_BYTES:
            self.flush()

    def flush(self) -> None:
        """Send what is gathered."""
        gathered, self._gathered, self._bytes = self._gathered, {}, 0
        for left, calls in zip(range(len(gathered) - 1, -1, -1), gathered.values(), strict=True):
            self._send(calls, is_last=not left)

    def _send(self, calls: list[EncodedCall], *, is_last: bool) -> None:
        first, envelope, payload = calls[0], calls[0].envelope, calls[0].payload
        self.has_crowd = len(calls) > 1
        if self.has_crowd:
            envelope, payload = encode_batch([call[:5] for call in calls]), b""
        is_sent = self._put(first.robot, first.key, envelope, payload, is_last=is_last)
        for call in calls:
            if not is_sent or not self._is_alive(call.robot):
                call.lose_all()
