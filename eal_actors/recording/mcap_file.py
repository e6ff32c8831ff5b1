"""`run.mcap`: writing and reading MCAP files, the exchange format that Foxglove and Lichtblick open."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from struct import error as StructError  # noqa: N812  # named like the other errors
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from eal_actors.device.picture_log import Findings
from eal_actors.kernel.errors import ScenarioError, UnsupportedError
from eal_actors.recording import messages, schemas
from eal_actors.recording.messages import Message, nanoseconds
from eal_actors.recording.poses import PoseSample
from eal_actors.recording.schemas import MessageSchema
from eal_actors.recording.timeline import log_entry_of
from eal_actors.scenario.report.records import as_json

if TYPE_CHECKING:
    from mcap.records import Chunk, McapRecord

RECORD_FILE: Final = "run.mcap"
EVENTS_TOPIC: Final = "/events"
ARENA_TOPIC: Final = "/arena"
HULLS_TOPIC: Final = "/robots"
TRANSFORMS_TOPIC: Final = "/tf"
FINDINGS_TOPIC: Final = "/pictures"
_CLOCK: Final = "clock"
_START: Final = "start_ns"
_LIBRARY: Final = "eal_actors"
_CHUNK_BYTES: Final = 65536
"""A crash of the controller loses at most so much of the end of a file; events.jsonl loses nothing."""
_UNPACKED_BYTES: Final = 64 * 1024 * 1024
_UNPACKED_TIMES: Final = 100
"""A record may unpack to so many bytes and so many times its size. Of ours, texts become a twentieth."""
_JSON: Final = "application/json"
_MAGIC: Final = b"\x89MCAP0\r\n"
"""The first and the last bytes of a whole file."""
_NS: Final = 1e9


def require_mcap() -> None:
    """Raise UnsupportedError, which names the extra, if the library is not installed."""
    try:
        import mcap.writer  # noqa: F401
    except ImportError as error:
        raise UnsupportedError("records need the mcap library: pip install 'eal-actors[record]'") from error


def _as_json(value: object) -> bytes:
    return as_json(value, separators=(",", ":")).encode()


class McapFile:
    """An MCAP file being written. The same messages in the same order with the same start make the same bytes.

    Times in the file are wall-clock times, so that viewers show the date; its metadata has the run's start, by which
    readers return seconds since then.

    Args:
        path: the file; an existing one is replaced.
        start: when the run starts; None for 1970, or for the start of the first file that is copied.

    Attributes:
        newest_s: the time of the newest message of each topic, in seconds since the run's start.

    Raises:
        UnsupportedError: the library is not installed.
        OSError: the file cannot be created.

    Thread: one at a time.
    """

    def __init__(self, path: Path, start: datetime | None = None) -> None:
        require_mcap()
        from mcap.writer import Writer

        self._stream = path.open("wb")
        self._writer = Writer(self._stream, chunk_size=_CHUNK_BYTES)
        self._writer.start(profile="", library=_LIBRARY)
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str], int] = {}  # by topic and schema: a camera may become one of another kind
        self._names: set[str] = set()
        self.attached: dict[str, Any] = {}
        self.counts: dict[str, int] = {}
        self.newest_s: dict[str, float] = {}
        self._start_ns = 0
        if start is not None:
            self.add_metadata(_CLOCK, {_START: str(nanoseconds(start.timestamp()))})

    def write(self, topic: str, schema: MessageSchema, time_s: float, message: Message) -> None:
        """Append a message; `time_s` counts from the run's start; raise OSError if it cannot be written."""
        shifted = messages.shifted(message, self._start_ns)
        self._add(topic, schema, self._start_ns + nanoseconds(time_s), _as_json(shifted))

    def _add(self, topic: str, schema: MessageSchema, time_ns: int, data: bytes) -> None:
        key = topic, schema.name
        channel = self._channels.get(key)
        if channel is None:
            channel = self._channels[key] = self._writer.register_channel(topic, "json", self._schema(schema))
        self.counts[topic] = self.counts.get(topic, 0) + 1
        self.newest_s[topic] = max(self.newest_s.get(topic, 0.0), (time_ns - self._start_ns) / _NS)
        self._writer.add_message(channel, log_time=time_ns, publish_time=time_ns, data=data)

    def copy(self, path: Path, wanted: Callable[[str, float], bool]) -> None:
        """Append the readable part of another file; attachments and metadata that exist here are kept.

        Seconds since the start stay the same, so the part of a resumed run has times as if it had not been interrupted.
        Messages are selected by their topic and these seconds.

        Raises:
            ScenarioError: it is no MCAP file.
            OSError: it cannot be read, or this one cannot be written.
        """
        from mcap.records import Attachment, Metadata

        with _errors_of(path):
            for record in _records(path):
                match record:
                    case _StoredMessage() if wanted(record.topic, record.time_s):
                        later_ns = self._start_ns - record.start_ns
                        data = record.data
                        if later_ns:
                            data = _as_json(messages.shifted(json.loads(data), later_ns))
                        self._add(record.topic, record.schema, record.log_ns + later_ns, data)
                    case Attachment():
                        self.attach(record.name, json.loads(record.data))
                    case Metadata():
                        self.add_metadata(record.name, record.metadata)

    def _schema(self, schema: MessageSchema) -> int:
        if schema.name not in self._schemas:
            content = json.dumps(schema.schema, separators=(",", ":")).encode()
            self._schemas[schema.name] = self._writer.register_schema(schema.name, "jsonschema", content)
        return self._schemas[schema.name]

    def attach(self, name: str, content: object) -> None:
        """Add a JSON document, unless one of this name exists."""
        if name in self._names:
            return
        self._names.add(name)
        self.attached[name] = content
        self._writer.add_attachment(0, 0, name, _JSON, _as_json(content))

    def flush(self) -> None:
        """Write what was attached so far to the disk, so that a crash does not lose it; raise OSError if that fails."""
        self._stream.flush()

    def add_metadata(self, name: str, texts: Mapping[str, str]) -> None:
        """Add texts by their keys, unless metadata of this name exists."""
        if name in self._names:
            return
        self._names.add(name)
        if name == _CLOCK:
            self._start_ns = int(texts[_START])
        self._writer.add_metadata(name, dict(texts))

    def close(self) -> None:
        """Write the index and close the file, which is closed even after an OSError. Closing it twice is harmless."""
        if self._stream.closed:
            return
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]  # the library leaves it bare
        finally:
            self._stream.close()

    def abandon(self) -> None:
        """Close the file as it is, after an OSError: an index would cover the message that was cut off."""
        with suppress(OSError):
            self._stream.close()


def pose_topic(robot: str, resource: str) -> str:
    """Return the topic of a robot's poses by one of its resources."""
    return f"/{robot}/{resource}"


def write_pose(file: McapFile, robot: str, resource: str, sample: PoseSample) -> None:
    """Write a pose for programs; raise OSError if it cannot be written."""
    file.write(pose_topic(robot, resource), schemas.POSE, sample.time_s, messages.pose_message(sample))


def write_path(file: McapFile, robot: str, resource: str, sample: PoseSample) -> None:
    """Write a pose of a path twice: for programs, and as the transform of viewers; raise OSError if that fails."""
    write_pose(file, robot, resource, sample)
    file.write(TRANSFORMS_TOPIC, schemas.TRANSFORMS, sample.time_s, messages.transform_message(robot, sample))


def write_event(file: McapFile, event: Mapping[str, Any]) -> None:
    """Write a line of `events.jsonl`, the call that it ends, and its log line; raise OSError if that fails."""
    time_s = event["time_s"]
    file.write(EVENTS_TOPIC, schemas.EVENT, time_s, {**messages.stamped(time_s), **event})
    if event["event"] == "step_ended" and event["record"]["resource"] is not None:
        record = event["record"]
        file.write(f"/{record['robot']}/commands", schemas.COMMAND, record["end_s"], messages.command_message(record))
    if (entry := log_entry_of(event)) is not None:
        log = messages.log_message(entry.time_s, entry.level, entry.source, entry.text)
        file.write("/log", schemas.LOG, entry.time_s, log)


def write_findings(file: McapFile, time_s: float, camera: str, stamp_s: float, found: Findings) -> None:
    """Write what was found in a picture; raise OSError if it cannot be written."""
    message = {**messages.stamped(time_s), "camera": camera, "stamp_s": stamp_s, "found": found}
    file.write(FINDINGS_TOPIC, schemas.FINDINGS, time_s, message)


def read_findings(path: Path) -> Iterator[tuple[str, float, Findings]]:
    """Yield what was found in pictures, as `write_findings` received it.

    Raises:
        ScenarioError: it is no MCAP file.
        OSError: it cannot be read.
    """
    with _errors_of(path):
        for record in _records(path):
            if isinstance(record, _StoredMessage) and record.topic == FINDINGS_TOPIC:
                content = json.loads(record.data)
                yield content["camera"], content["stamp_s"], content["found"]


@dataclass(frozen=True, slots=True)
class RecordedMessage:
    """One message of a file; its time is in seconds since the run's start."""

    time_s: float
    topic: str
    schema: str
    message: Message


@dataclass(slots=True)
class McapContent:
    """The content of a file; it is not complete if the end is missing, as after a crash of the controller."""

    messages: list[RecordedMessage] = field(default_factory=list)
    attachments: dict[str, Any] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    schemas: dict[str, Any] = field(default_factory=dict)
    is_complete: bool = False


def read_mcap(path: Path) -> McapContent:
    """Read the readable part of a file: if its writer crashed, the end is missing.

    Raises:
        UnsupportedError: the library is not installed.
        ScenarioError: it is no MCAP file of a run.
        OSError: it cannot be read.
    """
    require_mcap()
    from mcap.records import Attachment, Footer, Metadata

    content = McapContent()
    with _errors_of(path):
        for record in _records(path):
            match record:
                case _StoredMessage(topic, (name, schema)):
                    content.schemas[name] = schema
                    message = messages.shifted(json.loads(record.data), -record.start_ns)
                    content.messages.append(RecordedMessage(record.time_s, topic, name, message))
                case Attachment():
                    content.attachments[record.name] = json.loads(record.data)
                case Metadata():
                    content.metadata[record.name] = record.metadata
                case Footer():
                    content.is_complete = True
    return content


def is_whole(path: Path) -> bool:
    """Return whether a file ends as a finished one does; raise OSError if it cannot be read."""
    with path.open("rb") as stream:
        stream.seek(-min(len(_MAGIC), path.stat().st_size), os.SEEK_END)
        return stream.read() == _MAGIC


class _StoredMessage(NamedTuple):
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


def _records(path: Path) -> Iterator[_StoredMessage | McapRecord]:
    """Yield the readable records of a file, its messages with what the records before them say."""
    from mcap.exceptions import EndOfFile
    from mcap.records import Channel, Message, Metadata, Schema
    from mcap.stream_reader import StreamReader

    start_ns = 0
    known: dict[int, MessageSchema] = {}
    channels: dict[int, tuple[str, MessageSchema]] = {}
    with path.open("rb") as stream, suppress(EndOfFile, StructError):
        for record in _unpacked(StreamReader(stream, emit_chunks=True).records, path.stat().st_size):
            match record:
                case Schema():
                    known[record.id] = MessageSchema(record.name, json.loads(record.data))
                case Channel():
                    channels[record.id] = record.topic, known[record.schema_id]
                case Message():
                    yield _StoredMessage(*channels[record.channel_id], start_ns, record.log_time, record.data)
                case _:
                    if isinstance(record, Metadata) and record.name == _CLOCK:
                        start_ns = int(record.metadata[_START])
                    yield record


def _unpacked(records: Iterator[McapRecord], size: int) -> Iterator[McapRecord]:
    """Yield the records, those in chunks too, of a file of a size in bytes.

    The library would unpack a chunk whatever its size: a record of 100 kB could fill the memory.
    """
    from mcap.records import Chunk
    from mcap.stream_reader import breakup_chunk

    left = _UNPACKED_BYTES + _UNPACKED_TIMES * size
    for record in records:
        if not isinstance(record, Chunk):
            yield record
            continue
        data = _unpack(record, left + 1)
        left -= len(data)
        if left < 0:
            raise ValueError(f"it unpacks to more than {_UNPACKED_TIMES} times its size")
        if len(data) != record.uncompressed_size:
            raise ValueError("a chunk has another size than the file says")
        yield from breakup_chunk(replace(record, compression="", data=data), validate_crc=True)


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


@contextmanager
def _errors_of(path: Path) -> Iterator[None]:
    """Raise ScenarioError for every error that a broken file can cause."""
    from mcap.exceptions import McapError
    from mcap.stream_reader import CRCValidationError
    from zstandard import ZstdError

    damages = McapError, ZstdError, ValueError, KeyError, TypeError, AttributeError, OverflowError, MemoryError
    try:
        yield
    except (*damages, RuntimeError) as error:  # of lz4, or of a text that is nested too deeply
        is_damaged = isinstance(error, CRCValidationError | ZstdError)
        what = "is damaged" if is_damaged else "is no record of a run"
        raise ScenarioError(f"{path} {what}: {type(error).__name__}: {error}") from error
