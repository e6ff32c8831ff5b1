"""`run.mcap`: writing and reading MCAP files, the exchange format that Foxglove and Lichtblick open."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, Final, TypeAlias

from eal_actors.device.picture_log import Findings
from eal_actors.kernel.errors import UnsupportedError
from eal_actors.recording import messages, schemas
from eal_actors.recording.mcap_records import CLOCK, START, Loss, StoredMessage, broken_file, is_whole, stored_records
from eal_actors.recording.messages import Message, nanoseconds
from eal_actors.recording.poses import PoseSample
from eal_actors.recording.schemas import MessageSchema
from eal_actors.recording.timeline import log_entry_of
from eal_actors.scenario.report.records import as_json

TimedMessage: TypeAlias = tuple[str, MessageSchema, float, Message]
"""A topic, a schema, seconds since the run's start, and the message."""

RECORD_FILE: Final = "run.mcap"
DAMAGED_FILE: Final = "run.mcap.damaged"
"""The damaged file of which a repair has kept the rest, or the begin of its name if there are more."""
EVENTS_TOPIC: Final = "/events"
ARENA_TOPIC: Final = "/arena"
HULLS_TOPIC: Final = "/robots"
TRANSFORMS_TOPIC: Final = "/tf"
FINDINGS_TOPIC: Final = "/pictures"
_LIBRARY: Final = "eal_actors"
_CHUNK_BYTES: Final = 65536
"""A crash of the controller loses at most so much of the end of a file; events.jsonl loses nothing."""
_JSON: Final = "application/json"
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
        self.newest_s: dict[str, float] = {}
        self._start_ns = 0
        if start is not None:
            self.add_metadata(CLOCK, {START: str(nanoseconds(start.timestamp()))})

    def write(self, topic: str, schema: MessageSchema, time_s: float, message: Message) -> None:
        """Append a message; `time_s` counts from the run's start; raise OSError if it cannot be written."""
        shifted = messages.shifted(message, self._start_ns)
        self._add(topic, schema, self._start_ns + nanoseconds(time_s), _as_json(shifted))

    def write_all(self, timed: Iterable[TimedMessage]) -> None:
        """Append messages; raise OSError if one cannot be written."""
        for topic, schema, time_s, message in timed:
            self.write(topic, schema, time_s, message)

    def _add(self, topic: str, schema: MessageSchema, time_ns: int, data: bytes) -> None:
        key = topic, schema.name
        channel = self._channels.get(key)
        if channel is None:
            channel = self._channels[key] = self._writer.register_channel(topic, "json", self._schema(schema))
        self.newest_s[topic] = max(self.newest_s.get(topic, 0.0), (time_ns - self._start_ns) / _NS)
        self._writer.add_message(channel, log_time=time_ns, publish_time=time_ns, data=data)

    def copy(self, path: Path, wanted: Callable[[StoredMessage], bool], *, is_repair: bool = False) -> Loss | None:
        """Append the readable part of another file; attachments and metadata that exist here are kept.

        Seconds since the start stay the same, so the part of a resumed run has times as if it had not been interrupted.
        A repair leaves out what is damaged, and returns it.

        Raises:
            ScenarioError: it is no MCAP file, or it is damaged and this is no repair.
            OSError: it cannot be read, or this one cannot be written.
        """
        from mcap.records import Attachment, Metadata

        loss = None
        with broken_file(path):
            for record in stored_records(path, is_repair=is_repair):
                match record:
                    case Loss():
                        loss = record if loss is None else loss.plus(record)
                    case StoredMessage() if wanted(record):
                        later_ns = self._start_ns - record.start_ns
                        data = record.data
                        if later_ns:
                            data = _as_json(messages.shifted(json.loads(data), later_ns))
                        self._add(record.topic, record.schema, record.log_ns + later_ns, data)
                    case Attachment():
                        self.attach(record.name, json.loads(record.data))
                    case Metadata():
                        self.add_metadata(record.name, record.metadata)
        return loss

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
        if name == CLOCK:
            self._start_ns = int(texts[START])
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


def pose_messages(robot: str, resource: str, sample: PoseSample) -> Iterator[TimedMessage]:
    """Yield a pose for programs."""
    yield pose_topic(robot, resource), schemas.POSE, sample.time_s, messages.pose_message(sample)


def path_messages(robot: str, resource: str, sample: PoseSample) -> Iterator[TimedMessage]:
    """Yield a pose of a path twice: for programs, and as the transform of viewers."""
    yield from pose_messages(robot, resource, sample)
    yield TRANSFORMS_TOPIC, schemas.TRANSFORMS, sample.time_s, messages.transform_message(robot, sample)


def event_messages(event: Mapping[str, Any]) -> Iterator[TimedMessage]:
    """Yield a line of `events.jsonl`, the call that it ends, and its log line."""
    time_s = event["time_s"]
    yield EVENTS_TOPIC, schemas.EVENT, time_s, {**messages.stamped(time_s), **event}
    if event["event"] == "step_ended" and event["record"]["resource"] is not None:
        record = event["record"]
        yield f"/{record['robot']}/commands", schemas.COMMAND, record["end_s"], messages.command_message(record)
    if (entry := log_entry_of(event)) is not None:
        log = messages.log_message(entry.time_s, entry.level, entry.source, entry.text)
        yield "/log", schemas.LOG, entry.time_s, log


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
    with broken_file(path):
        for record in stored_records(path):
            if isinstance(record, StoredMessage) and record.topic == FINDINGS_TOPIC:
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
    from mcap.records import Attachment, Metadata

    content = McapContent(is_complete=is_whole(path))
    with broken_file(path):
        for record in stored_records(path):
            match record:
                case StoredMessage(topic, (name, schema)):
                    content.schemas[name] = schema
                    message = messages.shifted(json.loads(record.data), -record.start_ns)
                    content.messages.append(RecordedMessage(record.time_s, topic, name, message))
                case Attachment():
                    content.attachments[record.name] = json.loads(record.data)
                case Metadata():
                    content.metadata[record.name] = record.metadata
    return content
