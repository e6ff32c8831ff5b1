"""MCAP files: what robot developers exchange, and Foxglove and Lichtblick open."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from struct import error as StructError  # noqa: N812  # named like the other errors
from typing import TYPE_CHECKING, Any, Final

from eal_actors.errors import ScenarioError, UnsupportedError
from eal_actors.record.messages import Message, nanoseconds
from eal_actors.record.schemas import SchemaOf

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
    return json.dumps(_finite(value), separators=(",", ":"), allow_nan=False).encode()


def _finite(value: Any) -> Any:
    """Return a value with null for what JSON has no number for."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value


class McapFile:
    """A file that is being written. The same messages in the same order make the same bytes.

    Args:
        path: where it is made; what is there is replaced.

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

    def write(self, topic: str, schema: SchemaOf, time_s: float, message: Message) -> None:
        """Add a message; `time_s` counts from the run's start.

        Raises:
            OSError: it cannot be written.
        """
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self._writer.register_channel(topic, "json", self._schema(schema))
        time_ns = nanoseconds(time_s)
        self._writer.add_message(channel, log_time=time_ns, publish_time=time_ns, data=_as_json(message))

    def _schema(self, schema: SchemaOf) -> int:
        if schema.name not in self._schemas:
            content = json.dumps(schema.schema, separators=(",", ":")).encode()
            self._schemas[schema.name] = self._writer.register_schema(schema.name, "jsonschema", content)
        return self._schemas[schema.name]

    def attach(self, name: str, content: object) -> None:
        """Add a JSON document."""
        self._writer.add_attachment(0, 0, name, _JSON, _as_json(content))

    def note(self, name: str, texts: Mapping[str, str]) -> None:
        """Add texts by their names."""
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
        is_whole: False if the end is missing, as after a crash of the controller.
    """

    entries: list[Entry] = field(default_factory=list)
    attachments: dict[str, Any] = field(default_factory=dict)
    notes: dict[str, dict[str, str]] = field(default_factory=dict)
    is_whole: bool = False


def read_mcap(path: Path) -> McapContent:
    """Read a file of ours, as far as it goes: one whose writer crashed lacks its end.

    Raises:
        UnsupportedError: the library is not installed.
        ScenarioError: it is no such file.
        OSError: it cannot be read.
    """
    require_mcap()
    from mcap.exceptions import EndOfFile, McapError
    from mcap.records import Attachment, Footer, Metadata
    from mcap.records import Message as MessageRecord

    content = McapContent()
    names: dict[int, tuple[str, str]] = {}
    try:
        for record in _records(path, names):
            if isinstance(record, MessageRecord):
                topic, schema = names[record.channel_id]
                message = json.loads(record.data)
                content.entries.append(Entry(record.log_time / _NS, topic, schema, message))
            elif isinstance(record, Attachment):
                content.attachments[record.name] = json.loads(record.data)
            elif isinstance(record, Metadata):
                content.notes[record.name] = record.metadata
            elif isinstance(record, Footer):
                content.is_whole = True
    except (EndOfFile, StructError):
        return content
    except (McapError, ValueError, KeyError) as error:
        raise ScenarioError(f"{path} is no record of a run: {type(error).__name__}: {error}") from error
    return content


def _records(path: Path, names: dict[int, tuple[str, str]]) -> Iterator[McapRecord]:
    """Yield a file's records, and note the topics and schemas of its channels."""
    from mcap.records import Channel, Schema
    from mcap.stream_reader import StreamReader

    schemas: dict[int, str] = {}
    with path.open("rb") as stream:
        for record in StreamReader(stream).records:
            if isinstance(record, Schema):
                schemas[record.id] = record.name
            elif isinstance(record, Channel):
                names[record.id] = record.topic, schemas.get(record.schema_id, "")
            else:
                yield record
