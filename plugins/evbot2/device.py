"""The base as it is from outside: bytes in, bytes out, and time that passes."""

from __future__ import annotations

from typing import Protocol

from .firmware import Firmware
from .messages import Nonsense, Reply, Request, Verb


class BaseSide(Protocol):
    """What turns bytes into requests and replies into bytes."""

    @property
    def damaged(self) -> int:
        """How much of what came was passed over."""
        ...

    def feed(self, data: bytes) -> list[Request | Nonsense]:
        """Take bytes and return the requests that have become whole by them."""
        ...

    def encode(self, reply: Reply) -> bytes:
        """Return a reply as bytes."""
        ...


class Device:
    """A firmware behind a wire. Whoever owns it hands it bytes and the time.

    Args:
        firmware: what it does.
        codec: how it speaks.

    Attributes:
        firmware: what it does.
        nonsense: how many requests arrived whole and made no sense.

    Thread: its owner's; none of it blocks.
    """

    def __init__(self, firmware: Firmware, codec: BaseSide) -> None:
        self.firmware = firmware
        self.nonsense = 0
        self._codec = codec

    @property
    def is_busy(self) -> bool:
        """Whether something moves, so that `tick` must be called again and again."""
        return self.firmware.is_busy

    @property
    def damaged(self) -> int:
        """How many requests arrived damaged, and were passed over."""
        return self._codec.damaged

    @property
    def complaints(self) -> list[str]:
        """The counts of requests that it could not read, for `eal plugin check`."""
        counts = {"damaged": self.damaged, "without sense": self.nonsense}
        return [f"{count} requests {what}" for what, count in counts.items() if count]

    def tick(self, now_s: float) -> None:
        """Let time pass."""
        self.firmware.tick(now_s)

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Take bytes from the wire and return the replies to them.

        Args:
            data: any bytes, in pieces of any size.
            now_s: the time, which never goes backwards.
        """
        return b"".join(self.replies(data, now_s))

    def replies(self, data: bytes, now_s: float) -> list[bytes]:
        """Take bytes and return the replies to them one by one; see `feed`."""
        self.tick(now_s)
        return [self._codec.encode(self._answer(request, now_s)) for request in self._codec.feed(data)]

    def _answer(self, request: Request | Nonsense, now_s: float) -> Reply:
        if isinstance(request, Nonsense):
            self.nonsense += 1
            return Reply(Verb.NONE, request.tag, request.code)
        return self.firmware.handle(request, now_s)
