"""Exchange: one query under way, from its reply or the lack of one to an answer."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from eal_actors.clock import REAL_TIME
from eal_actors.errors import ProtocolError, UnavailableError
from eal_actors.net.sender import UrgentMessage
from eal_actors.net.wire import Answer, CallHeader, RobotTime, decode_reply, encode_call

if TYPE_CHECKING:
    import zenoh

    from eal_actors.net.controller import Controller

_TIMEOUT: Final = "Timeout"
"""How the engine says that nobody answered in time."""


class Exchange:
    """The two callbacks of a query.

    Args:
        on_answer: called with each answer, and the robot's clock if it came along.
        on_nothing: called when there is to be none.

    Thread: zenoh's, which both must not hold up.
    """

    __slots__ = ("is_answered", "on_answer", "on_nothing")

    def __init__(self, on_answer: Callable[[Answer, RobotTime | None], None], on_nothing: Callable[[], None]) -> None:
        self.on_answer = on_answer
        self.on_nothing = on_nothing
        self.is_answered = False

    def reply(self, reply: zenoh.Reply) -> None:
        """Take in an answer."""
        heard = read_reply(reply)
        if heard is not None:
            self.is_answered = True
            self.on_answer(*heard)

    def drop(self) -> None:
        """There will be no further answer."""
        if not self.is_answered:
            self.on_nothing()


def read_reply(reply: zenoh.Reply) -> tuple[Answer, RobotTime | None] | None:
    """Return an answer, and the robot's clock if it came along; None where it only says that there is no answer."""
    sample = reply.ok
    if sample is None:
        failed = reply.err
        reason = failed.payload.to_bytes().decode("utf-8", "replace") if failed is not None else "no reason given"
        return None if reason == _TIMEOUT else (UnavailableError(f"the network refuses: {reason}"), None)
    try:
        attachment = sample.attachment
        return decode_reply(attachment.to_bytes() if attachment is not None else b"", sample.payload.to_bytes())
    except ProtocolError as error:
        return error, None


class Question(UrgentMessage):
    """A query to the robot itself, with the times that tell how far its clock is from ours.

    Args:
        controller: the fleet's end of the network.
        key: of the method.
        header: of the call; its time to live is how long to wait for an answer.
        take: called with the answer, the robot's clock if it came along, and our clock (REAL_TIME) as the query left
            and as the answer came.
        miss: called when there is to be none.
        is_urgent: send it past everything that waits.
        insist: called with what sends it, should it still wait for another one's link; see UrgentMessage.

    Thread: `take` and `miss` run in zenoh's, which they must not hold up.
    """

    def __init__(
        self,
        controller: Controller,
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
        self._key = key
        self._header = header
        self._take = take
        self._exchange = Exchange(self._heard, miss)
        self._sent_s = math.nan

    def send(self, *, is_last: bool) -> None:
        """See Message."""
        if not self._is_taken.acquire(blocking=False):
            return
        header, exchange = self._header, self._exchange
        envelope, payload = encode_call(header._replace(has_more=not is_last))
        self._sent_s = REAL_TIME.now()
        self._controller.get(
            self._key,
            exchange.reply,
            exchange.drop,
            envelope,
            payload,
            header.ttl_s,
            is_urgent=self._is_urgent,
            is_last=is_last,
        )

    def insist(self) -> None:
        """See UrgentMessage."""
        if self._insist is not None and not self._is_taken.locked():
            self._insist(lambda: self.send(is_last=True))

    def _heard(self, answer: Answer, time: RobotTime | None) -> None:
        self._take(answer, time, self._sent_s, REAL_TIME.now())
