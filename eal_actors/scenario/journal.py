"""Tells listeners what happens, and writes it down as it happens, so that a crash loses nothing."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO

from eal_actors.kernel.errors import ScenarioError
from eal_actors.kernel.log import get_logger
from eal_actors.scenario.events import Event
from eal_actors.scenario.report import Report
from eal_actors.scenario.resuming import EVENTS, SUMMARY
from eal_actors.scenario.strict_json import as_json

Listener = Callable[[Event], None]


class Journal:
    """The events of one run.

    Args:
        directory: the run's folder, made if it is not there; None writes nothing.
        listeners: called with each event, in the thread of the run. One that raises is logged and called no more.
        goes_on: the folder holds the record of a run that was cut off, to which more is added.

    Raises:
        ScenarioError: the folder cannot be written, or holds a run already.
    """

    def __init__(self, directory: Path | None, listeners: Sequence[Listener], *, goes_on: bool = False) -> None:
        self._directory = directory
        self._listeners = list(listeners)
        self._stream: IO[str] | None = None
        if directory is None:
            return
        try:
            directory.mkdir(parents=True, exist_ok=True)
            if goes_on:
                cut_half_line(directory / EVENTS)
            self._stream = (directory / EVENTS).open("a" if goes_on else "x", encoding="utf-8", buffering=1)  # by lines
        except FileExistsError:
            raise ScenarioError(f"{directory} holds the record of a run already") from None
        except OSError as error:
            raise ScenarioError(f"the run's folder {directory} cannot be written: {error}") from error

    def tell(self, event: Event) -> None:
        """Write an event down, then tell the listeners.

        Raises:
            OSError: it could not be written; nothing is written any more after that.
        """
        try:
            if self._stream is not None:
                try:
                    self._stream.write(as_json(event.to_dict()) + "\n")
                except OSError:
                    self.close()
                    raise
        finally:
            for listener in list(self._listeners):
                self._call(listener, event)

    def _call(self, listener: Listener, event: Event) -> None:
        try:
            listener(event)
        except BaseException:  # noqa: BLE001  # it is a guest, and the robots are moving
            self._listeners.remove(listener)
            get_logger().exception("a listener raised; it is told no more", listener=repr(listener))

    def write_summary(self, report: Report) -> None:
        """Write the summary, whole or not at all.

        Raises:
            OSError: it could not be written.
        """
        if self._directory is None:
            return
        unfinished = self._directory / f"{SUMMARY}.tmp"
        with unfinished.open("w", encoding="utf-8") as stream:
            stream.write(as_json(report.model_dump(mode="json"), indent=2) + "\n")
            stream.flush()
            os.fsync(stream.fileno())
        unfinished.replace(self._directory / SUMMARY)

    def close(self) -> None:
        """Close the file of events. Calling it twice is harmless."""
        stream, self._stream = self._stream, None
        if stream is not None:
            try:
                stream.close()
            except OSError as error:
                get_logger().error("the file of events is cut short", reason=str(error))


def cut_half_line(path: Path) -> None:
    """Remove what a crash has left of a file's last line.

    Raises:
        OSError: the file cannot be changed.
    """
    with path.open("rb+") as stream:
        content = stream.read()
        stream.truncate(content.rfind(b"\n") + 1)
