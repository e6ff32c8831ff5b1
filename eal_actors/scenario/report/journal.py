"""The journal of a run: it writes each event at once, so that a crash loses none, and calls the listeners."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Final

from eal_actors.kernel import posix
from eal_actors.kernel.errors import ScenarioError
from eal_actors.kernel.log import get_logger
from eal_actors.scenario.report.events import RunEvent, StepStarted
from eal_actors.scenario.report.records import as_json
from eal_actors.scenario.report.summary import Report

EVENTS: Final = "events.jsonl"
SUMMARY: Final = "summary.json"
Listener = Callable[[RunEvent], None]


class Journal:
    """The events of one run.

    Args:
        directory: the run's folder, created if it does not exist; None writes nothing.
        listeners: called with each event, in the thread of the run. One that raises is logged and removed.
        is_resumed: the folder holds the record of an interrupted run; new events are appended.
        is_durable: each start of a step reaches the disk before the step begins, so that after the death of the machine
            another one, to which the folder belongs too, never repeats a command that may have been carried out.

    Raises:
        ScenarioError: the folder cannot be written, holds a run already, or one that is under way.
    """

    def __init__(
        self,
        directory: Path | None,
        listeners: Sequence[Listener],
        *,
        is_resumed: bool = False,
        is_durable: bool = False,
    ) -> None:
        self._directory = directory
        self._is_durable = is_durable
        self._listeners = list(listeners)
        self._stream: IO[str] | None = None
        if directory is None:
            return
        try:
            directory.mkdir(parents=True, exist_ok=True)
            mode = "a" if is_resumed else "x"
            self._stream = (directory / EVENTS).open(mode, encoding="utf-8", buffering=1)  # by lines
            _lock(self._stream, directory)
            if is_resumed:
                cut_half_line(directory / EVENTS)
        except FileExistsError:
            raise ScenarioError(f"{directory} already has the record of a run") from None
        except OSError as error:
            raise ScenarioError(f"the run's folder {directory} cannot be written: {error}") from error

    def write(self, event: RunEvent) -> None:
        """Write an event, then call the listeners; after an OSError, which it raises, later events are not written."""
        try:
            if self._stream is not None:
                try:
                    self._stream.write(as_json(event.to_dict()) + "\n")
                    if self._is_durable and isinstance(event, StepStarted):
                        os.fdatasync(self._stream.fileno())
                except OSError:
                    self.close()
                    raise
        finally:
            for listener in list(self._listeners):
                self._call(listener, event)

    def _call(self, listener: Listener, event: RunEvent) -> None:
        try:
            listener(event)
        except BaseException:  # noqa: BLE001  # a listener must not stop a run with moving robots
            self._listeners.remove(listener)
            get_logger().exception("a listener raised; it is removed", listener=repr(listener))

    def write_summary(self, report: Report) -> None:
        """Write the summary atomically; raise OSError if it could not be written."""
        if self._directory is None:
            return
        unfinished = self._directory / f"{SUMMARY}.tmp"
        with unfinished.open("w", encoding="utf-8") as stream:
            stream.write(as_json(report.model_dump(mode="json"), indent=2) + "\n")
            stream.flush()
            os.fsync(stream.fileno())
        unfinished.replace(self._directory / SUMMARY)

    def close(self) -> None:
        """Close the file of events. It may be called twice."""
        stream, self._stream = self._stream, None
        if stream is not None:
            try:
                stream.close()
            except OSError as error:
                get_logger().error("the file of events is incomplete", reason=str(error))


def _lock(stream: IO[str], directory: Path) -> bool:
    """Hold the record until the stream is closed or its process dies; raise ScenarioError if another one does.

    Return whether it is held.
    """
    try:
        posix.lock(stream)
    except BlockingIOError:
        raise ScenarioError(f"the run in {directory} is under way: another process writes its record") from None
    except OSError:  # a file system without locks
        get_logger().debug("the record cannot be locked", directory=str(directory))
        return False
    return True


@contextmanager
def hold_record(directory: Path) -> Iterator[bool]:
    """Hold the record of a run that has ended or was interrupted, as its journal does while it is under way.

    Yields whether it is held: a file system may have no locks.

    Raises:
        ScenarioError: the run is under way.
        OSError: the record cannot be opened.
    """
    with (directory / EVENTS).open("r+", encoding="utf-8") as stream:
        yield _lock(stream, directory)


def is_under_way(directory: Path) -> bool:
    """Return whether a process may write the record of a run; raise OSError if the record cannot be opened."""
    try:
        with hold_record(directory) as is_held:
            return not is_held
    except ScenarioError:
        return True


def cut_half_line(path: Path) -> None:
    """Remove an incomplete last line, which a crash has left; raise OSError if the file cannot be changed."""
    with path.open("rb+") as stream:
        content = stream.read()
        stream.truncate(content.rfind(b"\n") + 1)
