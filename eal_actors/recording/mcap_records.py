"""Reading the records of an MCAP file: in their order, or around damage; in bounded memory.

The content of a chunk has a checksum, and so has the summary at the end of the file, which repeats the schemas and
channels, and lists where each chunk is. So a repair finds all other chunks, whatever is damaged in the data.
"""

from __future__ import annotations

import json
import math
import os
import shlex
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from io import BytesIO
from itertools import takewhile
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final, NamedTuple

from eal_actors.kernel.errors import ScenarioError, error_text
from eal_actors.recording.schemas import MessageSchema

if TYPE_CHECKING:
    from mcap.records import AttachmentIndex, Chunk, ChunkIndex, McapRecord, MetadataIndex

CLOCK: Final = "clock"
START: Final = "start_ns"
_UNPACKED_BYTES: Final = 64 * 1024 * 1024
_UNPACKED_TIMES: Final = 100
"""A record may unpack to so many bytes and so many times its size. Of ours, texts become a twentieth."""
_MAGIC: Final = b"\x89MCAP0\r\n"
"""The first and the last bytes of a whole file."""
_FOOTER: Final = struct.Struct("<9xQQI8x")
"""The last bytes of a file: the places of the summary and of its index, and the checksum from there to this one."""
_HEADER: Final = struct.Struct("<BQ")
"""The kind of a record, and the length of what follows."""
_OTHER: Final = "it is not what the index lists"
_OF_CONTENT: Final = ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError, MemoryError
"""Errors of those who read what a stranger wrote."""
_NS: Final = 1e9


class _DamageError(Exception):
    """A part of the file is not as it was written."""


class StoredMessage(NamedTuple):
    """A message in a file, with the start of its run there; both times count from 1970."""

    topic: str
    schema: MessageSchema
    start_ns: int
    log_ns: int
    data: bytes

    @property
    def time_s(self) -> float:
        """Seconds since the run's start."""
        return (self.log_ns - self.start_ns) / _NS


class Loss(NamedTuple):
    """The unreadable part of a file.

    Attributes:
        reason: why; empty if a crash has cut off the end.
        size: the bytes of lost messages.
        from_s, until_s: their times since the run's start; the second is infinite if it is not known.
        name: that of a lost attachment, or of metadata.
    """

    reason: str
    size: int = 0
    from_s: float = math.inf
    until_s: float = -math.inf
    name: str = ""

    def plus(self, other: Loss) -> Loss:
        """Return both as one: a record of a stranger may have any number of them."""
        times_s = min(self.from_s, other.from_s), max(self.until_s, other.until_s)
        return Loss(self.reason or other.reason, self.size + other.size, *times_s, self.name or other.name)


class _Damage(NamedTuple):
    """A Loss as the file has it: with times since 1970, if they are known."""

    reason: str
    size: int
    times_ns: tuple[int, int] | None = None
    name: str = ""

    def loss(self, start_ns: int, newest_ns: int) -> Loss:
        """Return it with times since the run's start, at least those after the newest message."""
        if self.name:
            return Loss(self.reason, name=self.name)
        from_ns, until_ns = self.times_ns or (max(newest_ns, start_ns), math.inf)
        return Loss(self.reason, self.size, (from_ns - start_ns) / _NS, (until_ns - start_ns) / _NS)


def is_whole(path: Path) -> bool:
    """Return whether a file ends as a finished one does; raise OSError if it cannot be read."""
    with path.open("rb") as stream:
        stream.seek(-min(len(_MAGIC), path.stat().st_size), os.SEEK_END)
        return stream.read() == _MAGIC


@contextmanager
def broken_file(path: Path) -> Iterator[None]:
    """Raise ScenarioError for every error that a broken file can cause."""
    from mcap.exceptions import McapError

    try:
        yield
    except _DamageError as error:
        repair = f"eal records repair {shlex.quote(str(path.parent))}"
        raise ScenarioError(f"{path} is damaged: {error}; to keep the rest of it: {repair}") from error
    except (McapError, *_OF_CONTENT) as error:
        raise ScenarioError(f"{path} is no record of a run: {type(error).__name__}: {error}") from error


def stored_records(path: Path, *, is_repair: bool = False) -> Iterator[StoredMessage | Loss | McapRecord]:
    """Yield the readable records of a file, its messages with what the records before them say.

    Without a repair, damage raises an error; a file that a crash has cut off ends there. Use it in `broken_file`.
    """
    from mcap.records import Channel, Message, Metadata, Schema

    start_ns = newest_ns = 0
    known: dict[int, MessageSchema] = {}
    channels: dict[int, tuple[str, MessageSchema]] = {}
    with path.open("rb") as stream:
        for record in _records(stream, path.stat().st_size, is_repair=is_repair):
            match record:
                case Schema():
                    known[record.id] = MessageSchema(record.name, json.loads(record.data))
                case Channel() if not is_repair or record.schema_id in known:  # else the chunk with its schema is lost
                    channels[record.id] = record.topic, known[record.schema_id]
                case Message() if is_repair and record.channel_id not in channels:
                    yield _Damage(_OTHER, len(record.data), (record.log_time,) * 2).loss(start_ns, newest_ns)
                case Message():
                    newest_ns = max(newest_ns, record.log_time)
                    yield StoredMessage(*channels[record.channel_id], start_ns, record.log_time, record.data)
                case _Damage():
                    if record.reason and not start_ns:
                        raise ValueError("its start cannot be read")
                    yield record.loss(start_ns, newest_ns)
                case _:
                    if isinstance(record, Metadata) and record.name == CLOCK:
                        start_ns = int(record.metadata[START])
                    yield record


def _records(stream: IO[bytes], size: int, *, is_repair: bool) -> Iterator[McapRecord | _Damage]:
    """Yield the records of a file of a size in bytes, those in chunks too; only a repair yields damage."""
    from mcap.records import Message, Statistics

    if is_repair:
        yield from _unpacked(_around_damage(stream, size), size)
        return
    count = 0
    for record in _unpacked(_in_order(stream, size), size):
        match record:
            case _Damage(""):
                return
            case _Damage():
                raise _DamageError(record.reason)
            case Message():
                count += 1
            case Statistics() if record.message_count != count:
                raise _DamageError(f"it has {count} of {record.message_count} messages")
        yield record


def _in_order(stream: IO[bytes], size: int) -> Iterator[McapRecord | _Damage]:
    """Yield the records of the data in their order, then those of the summary, unless a crash has cut the file off.

    The library's reader would skip a chunk whose kind is damaged, and what follows one whose length is.
    """
    from mcap.exceptions import InvalidMagic
    from mcap.records import DataEnd

    stream.seek(max(0, size - len(_MAGIC)))
    is_cut_off = stream.read() != _MAGIC
    end = size if is_cut_off else size - len(_MAGIC)
    stream.seek(0)
    if end and (magic := stream.read(len(_MAGIC))) != _MAGIC[: len(magic)]:
        raise InvalidMagic(magic)
    place = len(_MAGIC)
    while place < end:
        stream.seek(place)
        header = stream.read(_HEADER.size)
        length = _HEADER.size + _HEADER.unpack(header)[1] if len(header) == _HEADER.size else size
        if place + length > end:
            yield _Damage("" if is_cut_off else "a record has another length than the file says", end - place)
            return
        yield (record := _record_at(stream, place, length))
        if isinstance(record, DataEnd):
            break
        place += length
    if not is_cut_off:
        summary = _summary(stream, size)
        yield from [_Damage("its index is not as it was written", 0)] if summary is None else summary


def _around_damage(stream: IO[bytes], size: int) -> Iterator[McapRecord | _Damage]:
    """Yield the schemas and channels of the summary, and the records that it lists; without it, those of the data."""
    from mcap.records import AttachmentIndex, Channel, ChunkIndex, DataEnd, MetadataIndex, Schema

    summary = _summary(stream, size)
    if summary is None:
        yield from takewhile(lambda record: not isinstance(record, DataEnd), _in_order(stream, size))
        return
    yield from (record for record in summary if isinstance(record, Schema | Channel))
    listed = (one for one in summary if isinstance(one, ChunkIndex | AttachmentIndex | MetadataIndex))
    end = 0
    for index in sorted(listed, key=_place):
        place, length = _place(index)
        if not end <= place <= place + length <= size:
            raise ValueError("its index lists places that cannot be")
        end = place + length
        record = _record_at(stream, place, length)
        if f"{type(record).__name__}Index" == type(index).__name__:
            yield record
        elif isinstance(index, ChunkIndex):
            yield _Damage(_OTHER, length, (index.message_start_time, index.message_end_time))
        else:
            yield _Damage(_OTHER, length, name=index.name)


def _summary(stream: IO[bytes], size: int) -> list[McapRecord] | None:
    """Return the records of the summary of a file; None if it is damaged, or a crash has cut it off."""
    from mcap.stream_reader import StreamReader

    if size < _FOOTER.size:
        return None
    stream.seek(size - _FOOTER.size)
    start, _, checksum = _FOOTER.unpack(stream.read())
    stream.seek(min(start or size - _FOOTER.size, size))
    summary = stream.read()[: -len(_MAGIC)]
    if checksum not in (0, zlib.crc32(summary[:-4])):  # other writers may leave it out, and the summary too
        return None
    with suppress(*_unreadable()):
        return list(StreamReader(BytesIO(summary + _MAGIC), skip_magic=True, emit_chunks=True).records)
    return None


def _place(index: ChunkIndex | AttachmentIndex | MetadataIndex) -> tuple[int, int]:
    """Return where in the file a record is, and its length."""
    from mcap.records import ChunkIndex

    if isinstance(index, ChunkIndex):
        return index.chunk_start_offset, index.chunk_length
    return index.offset, index.length


def _record_at(stream: IO[bytes], place: int, length: int) -> McapRecord | _Damage:
    """Return a record with its header; damage if it is not as it was written."""
    from mcap.records import Attachment
    from mcap.stream_reader import CRCValidationError, StreamReader

    stream.seek(place)
    content = stream.read(length)
    try:
        record = next(StreamReader(BytesIO(content), skip_magic=True, emit_chunks=True).records)
        checksum, found = int.from_bytes(content[-4:], "little"), zlib.crc32(content[_HEADER.size : -4])
        if isinstance(record, Attachment) and checksum not in (0, found):
            raise CRCValidationError(checksum, found, record)
    except _unreadable() as error:
        return _Damage(f"a record cannot be read: {error_text(error)}", length)
    return record


def _unreadable() -> tuple[type[Exception], ...]:
    """Return the errors of the libraries that read a record, or unpack a chunk, that is not as it was written."""
    from mcap.exceptions import McapError
    from zstandard import ZstdError

    return McapError, ZstdError, RuntimeError, struct.error, ValueError, OverflowError, MemoryError  # RuntimeError: lz4


def _unpacked(records: Iterator[McapRecord | _Damage], size: int) -> Iterator[McapRecord | _Damage]:
    """Yield the records, those in chunks too, of a file of a size in bytes.

    The library would unpack a chunk whatever its size: a record of 100 kB could fill the memory.
    """
    from mcap.records import Chunk

    left = _UNPACKED_BYTES + _UNPACKED_TIMES * size
    for record in records:
        if not isinstance(record, Chunk):
            yield record
            continue
        unpacked, content, problem = _opened(record, left)
        left -= unpacked
        if left < 0:
            raise ValueError(f"it unpacks to more than {_UNPACKED_TIMES} times its size")
        yield from content
        if problem:
            yield _Damage(problem, len(record.data), (record.message_start_time, record.message_end_time))


def _opened(chunk: Chunk, left: int) -> tuple[int, list[McapRecord], str]:
    """Return how much of at most so many bytes a chunk unpacks to, its records, and why they cannot be read."""
    from mcap.stream_reader import breakup_chunk

    unpacked = min(left, chunk.uncompressed_size)
    try:
        data = _unpack(chunk, unpacked + 1)
        unpacked = len(data)
        if unpacked != chunk.uncompressed_size:
            raise ValueError("it has another size than the file says")
        return unpacked, breakup_chunk(replace(chunk, compression="", data=data), validate_crc=True), ""
    except _unreadable() as error:
        return unpacked, [], f"a chunk cannot be read: {error_text(error)}"


def _unpack(chunk: Chunk, most: int) -> bytes:
    """Return the content of a chunk, at most so many bytes of it."""
    match chunk.compression:
        case "zstd":
            from zstandard import ZstdDecompressor

            return ZstdDecompressor().stream_reader(chunk.data).read(most)
        case "lz4":
            from lz4.frame import LZ4FrameDecompressor

            return bytes(LZ4FrameDecompressor().decompress(chunk.data, max_length=most))
        case "":
            return chunk.data
        case other:
            raise ValueError(f"the compression {other[:20]!r} is not known")
