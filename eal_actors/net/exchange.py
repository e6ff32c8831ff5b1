"""Exchange: one query under way, from its reply or the lack of one to an answer."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from eal_actors.errors import ProtocolError, UnavailableError
from eal_actors.net.wire import Answer, RobotTime, decode_reply

if TYPE_CHECKING:
    import zenoh

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
        sample = reply.ok
        time: RobotTime | None = None
        if sample is None:
            failed = reply.err
            reason = failed.payload.to_bytes().decode("utf-8", "replace") if failed is not None else "no reason given"
            if reason == _TIMEOUT:  # which is no answer, but the lack of one
                return
            answer: Answer = UnavailableError(f"the network refuses: {reason}")
        else:
            try:
                attachment = sample.attachment
                envelope = attachment.to_bytes() if attachment is not None else b""
                answer, time = decode_reply(envelope, sample.payload.to_bytes())
            except ProtocolError as error:
                answer = error
        self.is_answered = True
        self.on_answer(answer, time)

    def drop(self) -> None:
        """There will be no further answer."""
        if not self.is_answered:
            self.on_nothing()
