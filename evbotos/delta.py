"""The part of an update that a robot lacks: pieces to send, and pieces that it copies from the system that it runs.

The robot names digests of its blocks of 4096 bytes. A block that is in place already, as after an interrupted push, is
left out. The others are searched at every offset of the new file, as rsync does, because one changed file shifts all
that follows it in a compressed root. Digests only save traffic: the robot verifies the whole afterwards.
"""

from __future__ import annotations

import hashlib
import struct
from bisect import bisect_left
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

BLOCK: Final = 4096
PARTS: Final = ("kernel", "root")
"""The parts of a system, by the number that the robot knows them by."""
_DIGEST: Final = struct.Struct(">I8s")
_PIECE: Final = struct.Struct(">cBQI")
_SOURCE: Final = struct.Struct(">BQ")
_PRIME: Final = 65521
_WINDOW: Final = 1 << 20
"""Offsets whose sums are computed at once, which bounds the memory."""


@dataclass(frozen=True, slots=True)
class Piece:
    """A run of bytes of the new file that the robot lacks in its place.

    Attributes:
        start: its offset in the new file.
        source: the offset in the robot's running part that has the same bytes; None if they must be sent.
    """

    start: int
    length: int
    source: int | None = None


def missing_pieces(new: bytes, present: bytes, running: bytes) -> list[Piece]:
    """Return the pieces that make the other slot's part equal to the new file.

    Args:
        new: the new file.
        present: the digests of what is in the other slot now.
        running: the digests of the running part.
    """
    named = list(_DIGEST.iter_unpack(running))
    sources = {strong: index * BLOCK for index, (_, strong) in enumerate(named)}
    offsets = matching_offsets(new, np.array([weak for weak, _ in named], np.uint32))
    found: list[Piece] = []
    for start, end in _not_in_place(new, present):
        for piece in _pieces_of(new, start, end, offsets, sources):
            _append(found, piece)
    return found


def matching_offsets(new: bytes, weak: NDArray[np.uint32]) -> NDArray[np.int64]:
    """Return the offsets of the new file at which a block has one of some Adler-32 sums, in order."""
    content = np.frombuffer(new, np.uint8)
    found = []
    for first in range(0, max(0, len(content) - BLOCK + 1), _WINDOW):
        window = content[first : first + _WINDOW + BLOCK - 1].astype(np.int64)
        sums = np.concatenate(([0], np.cumsum(window)))
        weighted = np.concatenate(([0], np.cumsum(window * np.arange(len(window)))))
        starts = np.arange(len(window) - BLOCK + 1)
        plain = sums[BLOCK:] - sums[:-BLOCK]
        low = (1 + plain) % _PRIME
        high = (BLOCK + (BLOCK + starts) * plain - (weighted[BLOCK:] - weighted[:-BLOCK])) % _PRIME
        found.append(first + np.flatnonzero(np.isin((high << 16 | low).astype(np.uint32), weak)))
    return np.concatenate(found) if found else np.zeros(0, np.int64)


def _not_in_place(new: bytes, present: bytes) -> Iterator[tuple[int, int]]:
    """Yield the runs of the new file that differ from what is in the other slot: start and end."""
    digests = list(_DIGEST.iter_unpack(present))
    start = None
    for index, place in enumerate(range(0, len(new), BLOCK)):
        is_same = index < len(digests) and _strong(new, place) == digests[index][1] and place + BLOCK <= len(new)
        if is_same and start is not None:
            yield start, place
            start = None
        elif not is_same and start is None:
            start = place
    if start is not None:
        yield start, len(new)


def _pieces_of(
    new: bytes, start: int, end: int, offsets: NDArray[np.int64], sources: dict[bytes, int]
) -> Iterator[Piece]:
    place = start
    index = bisect_left(offsets, start)
    while index < len(offsets) and (offset := int(offsets[index])) + BLOCK <= end:
        source = sources.get(_strong(new, offset)) if offset >= place else None
        if source is None:
            index += 1
            continue
        if offset > place:
            yield Piece(place, offset - place)
        yield Piece(offset, BLOCK, source)
        place = offset + BLOCK
        index = bisect_left(offsets, place, index)
    if place < end:
        yield Piece(place, end - place)


def _strong(content: bytes, place: int) -> bytes:
    return hashlib.sha256(content[place : place + BLOCK]).digest()[:8]


def _append(found: list[Piece], piece: Piece) -> None:
    """Join a piece with the last one where both are one run."""
    if found and found[-1].start + found[-1].length == piece.start:
        last = found[-1]
        follows = piece.source == (None if last.source is None else last.source + last.length)
        if follows and (last.source is None) == (piece.source is None):
            found[-1] = Piece(last.start, last.length + piece.length, last.source)
            return
    found.append(piece)


def messages(part: str, new: bytes, pieces: Iterable[Piece], most_bytes: int) -> Iterator[tuple[bytes, int]]:
    """Yield the messages that write some pieces, with the number of the new file's bytes that each completes.

    Args:
        part: the part that they belong to.
        new: the new file.
        pieces: the pieces.
        most_bytes: the most bytes that one message sends, or lets the robot copy.
    """
    number = PARTS.index(part)
    message, done = bytearray(), 0
    for piece in pieces:
        for start in range(piece.start, piece.start + piece.length, most_bytes):
            length = min(most_bytes, piece.start + piece.length - start)
            if message and done + length > most_bytes:
                yield bytes(message), done
                message, done = bytearray(), 0
            if piece.source is None:
                message += _PIECE.pack(b"d", number, start, length) + new[start : start + length]
            else:
                message += _PIECE.pack(b"c", number, start, length)
                message += _SOURCE.pack(number, piece.source + start - piece.start)
            done += length
    if message:
        yield bytes(message), done
