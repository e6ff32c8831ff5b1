"""MCAP files: what robot developers exchange, and Foxglove and Lichtblick open."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from struct import error as StructError  # noqa: N812  # named like the other errors
from typing import TYPE_CHECKING, Any, Final

from eal_actors.kernel.errors import ScenarioError, UnsupportedError
from eal_actors.recording.messages import Message, nanoseconds
from eal_actors.recording.schemas import SchemaOf
from eal_actors.scenario.report.records import as_json

if TYPE_CHECKING:
    from mcap.records import McapRecord

RECORD_FILE: Final = "run.mcap"
_LIBRARY: Final = "eal_actors"
_CHUNK_BYTES: Final = 65536
"""What a crash of the controller may cost of the end of a file; events.jsonl loses nothing."""
_JSON: Final = "application/json"
_NS: Final = 1e9


def require_mcap() -> None:
    """Raise UnsupportedError, which names the extra, where the library is not installed."""
    try:
        import mcap.writer  # noqa: F401
    except ImportError as error:
        raise UnsupportedError("records need the mcap library: pip install 'eal-actors[record]'") from error


def _as_json(value: object) -> bytes:
    return as_json(value, separators=(",", ":")).encode()


class McapFile:
    """A file that is being written. The same messages in the same order make the same bytes.

    Args:
        path: where it is made; what is there is replaced.

    Attributes:
        counts: how many messages each topic has.
        newest_s: the time of the newest of them, in seconds since the run's start.

    Raises:
        UnsupportedError: the library is not installed.
        OSError: it cannot be made.

    Thread: one at a time.
    """

    def __init__(self, path: Path) -> None:
        require_mcap()
        from mcap.writer import Writer

        self._stream = path.open("wb")
        self._writer = Writer(self._stream, chunk_size=_CHUNK_BYTES)
        self._writer.start(profile="", library=_LIBRARY)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._names: set[str] = set()
        self.counts: dict[str, int] = {}
        self.newest_s: dict[str, float] = {}

    def write(self, topic: str, schema: SchemaOf, time_s: float, message: Message) -> None:
        """Add a message; `time_s` counts from the run's start.

        Raises:
            OSError: it cannot be written.
        """
        self._add(topic, schema, nanoseconds(time_s), _as_json(message))

    def _add(self, topic: str, schema: SchemaOf, time_ns: int, data: bytes) -> None:
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self._writer.register_channel(topic, "json", self._schema(schema))
        self.counts[topic] = self.counts.get(topic, 0) + 1
        self.newest_s[topic] = max(self.newest_s.get(topic, 0.0), time_ns / _NS)
        self._writer.add_message(channel, log_time=time_ns, publish_time=time_ns, data=data)

    def copy(self, path: Path, without: Collection[str] = ()) -> None:
        """Add what another file holds, as far as that goes; documents and texts that are here already stay as they are.

        Args:
            path: the other file.
            without: the topics that are left out.

        Raises:
            ScenarioError: it is no such file.
            OSError: it cannot be read, or this one cannot be written.
        """
        from mcap.records import Attachment, Channel, Message, Metadata, Schema

        schemas: dict[int, SchemaOf] = {}
        channels: dict[int, tuple[str, SchemaOf]] = {}
        with _understanding(path):
            for record in _records(path):
                match record:
                    case Schema():
                        schemas[record.id] = SchemaOf(record.name, json.loads(record.data))
                    case Channel():
                        channels[record.id] = record.topic, schemas[record.schema_id]
                    case Message():
                        topic, schema = channels[record.channel_id]
                        if topic not in without:
                            self._add(topic, schema, record.log_time, record.data)
                    case Attachment():
                        self.attach(record.name, json.loads(record.data))
                    case Metadata():
                        self.note(record.name, record.metadata)

    def _schema(self, schema: SchemaOf) -> int:
        if schema.name not in self._schemas:
            content = json.dumps(schema.schema, separators=(",", ":")).encode()
            self._schemas[schema.name] = self._writer.register_schema(schema.name, "jsonschema", content)
        return self._schemas[schema.name]

    def attach(self, name: str, content: object) -> None:
        """Add a JSON document, unless there is one of this name."""
        if name in self._names:
            return
        self._names.add(name)
        self._writer.add_attachment(0, 0, name, _JSON, _as_json(content))

    def note(self, name: str, texts: Mapping[str, str]) -> None:
        """Add texts by their names, unless there are some under this one."""
        if name in self._names:
            return
        self._names.add(name)
        self._writer.add_metadata(name, dict(texts))

    def close(self) -> None:
        """Write the index and close the file; harmless if it is closed.

        Raises:
            OSError: the index cannot be written; the file is closed all the same.
        """
        if self._stream.closed:
            return
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]  # the library leaves it bare
        finally:
            self._stream.close()


@dataclass(frozen=True, slots=True)
class Entry:
    """One message of a file.

    Attributes:
        time_s: since the run's start.
        topic: where it was written to.
        schema: the name of its schema.
        message: what it says.
    """

    time_s: float
    topic: str
    schema: str
    message: Message


@dataclass(slots=True)
class McapContent:
    """What a file holds.

    Attributes:
        entries: its messages, in the order of the file.
        attachments: its JSON documents by name.
        notes: its texts by name.
        schemas: the JSON Schemas of its messages by name.
        is_whole: False if the end is missing, as after a crash of the controller.
    """

    entries: list[Entry] = field(default_factory=list)
    attachments: dict[str, Any] = field(default_factory=dict)
    notes: dict[str, dict[str, str]] = field(default_factory=dict)
    schemas: dict[str, Any] = field(default_factory=dict)
    is_whole: bool = False


def read_mcap(path: Path) -> McapContent:
    """Read a file of ours, as far as it goes: one whose writer crashed lacks its end.

    Raises:
        UnsupportedError: the library is not installed.
        ScenarioError: it is no such file.
        OSError: it cannot be read.
    """
    require_mcap()
    from mcap.records import Attachment, Channel, Footer, Metadata, Schema
    from mcap.records import Message as MessageRecord

    content = McapContent()
    schemas: dict[int, str] = {}
    names: dict[int, tuple[str, str]] = {}
    with _understanding(path):
        for record in _records(path):
            match record:
                case Schema():
                    schemas[record.id] = record.name
                    content.schemas[record.name] = json.loads(record.data)
                case Channel():
                    names[record.id] = record.topic, schemas[record.schema_id]
                case MessageRecord():
                    topic, schema = names[record.channel_id]
                    content.entries.append(Entry(record.log_time / _NS, topic, schema, json.loads(record.data)))
                case Attachment():
                    content.attachments[record.name] = json.loads(record.data)
                case Metadata():
                    content.notes[record.name] = record.metadata
                case Footer():
                    content.is_whole = True
    return content


def _records(path: Path) -> Iterator[McapRecord]:
    """Yield a file's records, as far as it goes."""
    from mcap.exceptions import EndOfFile
    from mcap.stream_reader import StreamReader

    with path.open("rb") as stream:
        try:
            yield from StreamReader(stream).records
        except (EndOfFile, StructError):
            return


@contextmanager
def _understanding(path: Path) -> Iterator[None]:
    """Say of a file's records that they make no sense.

    Raises:
        ScenarioError: they make none.
    """
    from mcap.exceptions import McapError
    from zstandard import ZstdError

    try:
        yield
    except (McapError, ZstdError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ScenarioError(f"{path} is no record of a run: {type(error).__name__}: {error}") from error
