"""AuditLog: every command of agents and of the dashboard's users in a file: who, what, when, from where, its outcome.

A command leaves one line when it begins and one when it ends, so that a crash between them hides nothing. Lines are
written by a thread of their own: no command waits for a disk, least of all a stop.
"""

from __future__ import annotations

import itertools
import json
import logging
import os
import queue
import secrets
import threading
from collections.abc import Callable, Mapping
from datetime import datetime
from io import TextIOWrapper
from logging.handlers import QueueListener, RotatingFileHandler
from pathlib import Path
from typing import Any, Final, Self

from typing_extensions import override

from eal_actors.kernel.clock import wall_time
from eal_actors.kernel.errors import file_error, writing
from eal_actors.kernel.log import get_logger

AUDIT_FILE: Final = "audit.jsonl"
"""In the folder of runs. Older parts have the endings .1 to .9."""
_MOST_BYTES: Final = 10_000_000
_OLDER_FILES: Final = 9
_MOST_WAITING: Final = 10_000
_MOST_OUTCOME: Final = 1000
"""Characters of an outcome: an error repeats what an agent wrote, which may be as long as the whole log."""

Finish = Callable[[str], None]
"""Records the outcome of a command: `ok`, or its error."""


class AuditLog:
    """Records commands between `start` and `close`. With no folder, it records nothing.

    Raises ConfigError if the file cannot be written. Thread: any; never blocks.
    """

    def __init__(self, folder: Path | None) -> None:
        self._numbers = itertools.count(1)
        self._process = secrets.token_hex(4)
        self._queue: queue.Queue[logging.LogRecord] = queue.Queue(_MOST_WAITING)
        self._listener: QueueListener | None = None
        if folder is not None:
            with writing(folder / AUDIT_FILE):
                folder.mkdir(parents=True, exist_ok=True)
                handler = _PrivateFile(folder / AUDIT_FILE, maxBytes=_MOST_BYTES, backupCount=_OLDER_FILES)
            self._listener = QueueListener(self._queue, handler)

    def start(self) -> Self:
        """Start to write; return the log itself."""
        if self._listener is not None:
            self._listener.start()
        return self

    def close(self) -> None:
        """Write the rest, and close the file. Thread: blocks the caller."""
        if self._listener is not None:
            self._listener.stop()
            for handler in self._listener.handlers:
                handler.close()
            self._listener = None

    def begin(self, user: Mapping[str, str], command: str, arguments: Mapping[str, Any]) -> Finish:
        """Record the beginning of a command; return the function that records its end, once."""
        number = f"{self._process}-{next(self._numbers)}"
        self._write({"id": number, **user, "command": command, "arguments": arguments})
        has_ended = threading.Lock()

        def finish(outcome: str) -> None:
            if has_ended.acquire(blocking=False):
                self._write({"id": number, "outcome": outcome[:_MOST_OUTCOME]})

        return finish

    def _write(self, fields: Mapping[str, Any]) -> None:
        if self._listener is None:
            return
        line = json.dumps({"at": wall_time().isoformat(timespec="milliseconds"), **fields})
        try:
            self._queue.put_nowait(logging.makeLogRecord({"msg": line}))
        except queue.Full:
            get_logger().error("the audit log is too slow: an entry is lost", entry=line)


class _PrivateFile(RotatingFileHandler):
    """A file that only its owner can read; an error in writing is logged, and stops no command."""

    @override
    def _open(self) -> TextIOWrapper:
        stream = os.fdopen(os.open(self.baseFilename, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600), "a")
        content = Path(self.baseFilename).read_bytes()
        if content and not content.endswith(b"\n"):  # a crash has cut off the last line, which must not spoil the next
            stream.write("\n")
        return stream

    @override
    def handleError(self, record: logging.LogRecord) -> None:
        get_logger().error("an entry could not be written to the audit log", entry=record.msg, exc_info=True)


def read_audit(folder: Path) -> list[dict[str, Any]]:
    """Return the commands in the audit log of a folder, the oldest first; `outcome` is None without an end.

    Raises ConfigError if there is no audit log, or it cannot be read.
    """
    newest = folder / AUDIT_FILE
    files = [newest.with_name(f"{AUDIT_FILE}.{number}") for number in range(_OLDER_FILES, 0, -1)]
    entries: dict[str, dict[str, Any]] = {}
    try:
        texts = [file.read_text("utf-8", "replace") for file in files if file.exists()]
        texts.append(newest.read_text("utf-8", "replace"))
    except OSError as error:
        raise file_error(newest, f"cannot be read: {error.strerror}") from error
    for line in (line for text in texts for line in text.splitlines() if line):
        if (fields := _parse_line(line)) is None:  # cut off by a crash
            get_logger().warning("a line of the audit log is damaged", line=line[:200])
        elif "command" in fields:
            entries[fields["id"]] = {**fields, "outcome": None, "ended": None}
        elif fields["id"] in entries:
            entries[fields["id"]] |= {"outcome": fields["outcome"], "ended": fields["at"]}
    return list(entries.values())


def _parse_line(line: str) -> dict[str, Any] | None:
    """Return a line of the log, the beginning or the end of a command; None if it is damaged."""
    try:
        fields: dict[str, Any] = json.loads(line)
        texts = ("id", "at", *(("who", "from", "command") if "command" in fields else ("outcome",)))
        datetime.fromisoformat(fields["at"])
        is_whole = all(isinstance(fields[key], str) for key in texts)
    except (ValueError, KeyError, TypeError):
        return None
    return fields if is_whole and isinstance(fields.get("arguments", {}), dict) else None
