"""The wire codecs: they split a byte stream into messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

_In = TypeVar("_In")
_Out = TypeVar("_Out")


class Codec(Generic[_In, _Out]):
    """Decodes incoming messages from pieces of any size, and encodes outgoing ones. Damaged messages are skipped.

    Args:
        encode: returns a message as bytes.
        decode: returns the message in a piece without its delimiter; None if it is damaged.
        delimiter: the byte that ends a message.
        longest: how many bytes without a delimiter to keep.
        skip_empty: whether an empty message is no error.

    Attributes:
        damaged: the number of skipped messages.
    """

    def __init__(
        self,
        encode: Callable[[_Out], bytes],
        decode: Callable[[bytes], _In | None],
        delimiter: bytes,
        longest: int,
        *,
        skip_empty: bool,
    ) -> None:
        self.encode = encode
        self.damaged = 0
        self._decode = decode
        self._delimiter = delimiter
        self._longest = longest
        self._skip_empty = skip_empty
        self._partial = bytearray()

    def feed(self, data: bytes) -> list[_In]:
        """Take bytes and return the messages that they complete."""
        self._partial += data
        *pieces, rest = self._partial.split(self._delimiter)
        self._partial = rest[-self._longest :]
        parsed = [self._decode(bytes(piece)) for piece in pieces if piece or not self._skip_empty]
        found = [message for message in parsed if message is not None]
        self.damaged += len(parsed) - len(found)
        return found

    def reset(self) -> None:
        """Discard an incomplete message."""
        self._partial.clear()
