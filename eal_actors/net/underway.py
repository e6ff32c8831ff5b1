"""UnderWay: the commands that a robot carries out for controllers, and the answers that wait for their ends."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from eal_actors.actors.call import Call
from eal_actors.actors.robot_view import command_of
from eal_actors.device.resource import Progress
from eal_actors.net.messages import CallId, ReplyTo
from eal_actors.net.timing import real_time_of

PROGRESS_EACH_S: Final = 0.25
"""Real seconds between two events of one command's progress, at least."""

_MOST_TEXT: Final = 200


@dataclass(eq=False, slots=True)
class Running:
    """A command under way.

    Attributes:
        call_id: which it is.
        to: who waits for the answer; None once that was given.
        call: the call to the resource.
        since_s: when it came, in real time.
        is_announced: everybody was told that it runs.
        told: what was told of its progress last.
        told_s: when that was, in real time.
    """

    call_id: CallId
    to: ReplyTo | None
    call: Call[Any]
    since_s: float
    is_announced: bool = False
    told: Progress | None = None
    told_s: float = -math.inf

    @property
    def has_begun(self) -> bool:
        """Whether it waits for its start no more."""
        return self.call.start_s is None or self.call.began_s is not None

    def about(self) -> dict[str, Any]:
        """Return what controllers are told of it; its times are of the robot's real time."""
        call = self.call
        began_s = self.since_s if call.began_s is None else real_time_of(call.clock, call.began_s)
        about = {"resource": call.cell.name, "command": _cut(command_of(call)), "by": call.caller, "since_s": began_s}
        return {**about, **self.progress()}

    def progress(self) -> dict[str, Any]:
        """Return what controllers are told of its progress."""
        progress = self.call.progress()
        if progress is None:
            return {}
        time_s = real_time_of(self.call.clock, progress.time_s)
        return {"progress": [progress.fraction, _cut(progress.text), time_s]}


class UnderWay:
    """The commands under way on one robot. Each answer is owed once. Thread: any."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: dict[CallId, Running] = {}

    def add(self, running: Running) -> None:
        """Take in a command that has been passed on to its resource."""
        with self._lock:
            self._running[running.call_id] = running

    def end(self, running: Running) -> ReplyTo | None:
        """Let go of a command that has ended; returns who still waits for its end."""
        with self._lock:
            self._running.pop(running.call_id, None)
            to, running.to = running.to, None
        return to

    def take_long(self, since_s: float) -> list[tuple[Running, ReplyTo]]:
        """Return the commands that came at that time or before, with those who still wait for their answers."""
        if not self._running:  # as it mostly is, and as is asked often
            return []
        taken = []
        with self._lock:
            for running in self._running.values():
                to = running.to
                if to is not None and running.since_s <= since_s:
                    running.to = None
                    taken.append((running, to))
        return taken

    def take_begun(self) -> list[Running]:
        """Return the commands that have begun and take long, and were not returned before."""
        with self._lock:
            begun = [running for running in self._long() if not running.is_announced and running.has_begun]
            for running in begun:
                running.is_announced = True
        return begun

    def take_progressed(self, now_s: float) -> list[Running]:
        """Return the commands whose progress is to be told now, as it was not before."""
        progressed = []
        with self._lock:
            for running in self._long():
                progress = running.call.progress()
                if progress is not running.told and now_s - running.told_s >= PROGRESS_EACH_S and running.is_announced:
                    running.told, running.told_s = progress, now_s
                    progressed.append(running)
        return progressed

    def announced(self) -> list[Running]:
        """Return the commands that everybody was told of."""
        with self._lock:
            return [running for running in self._running.values() if running.is_announced]

    def _long(self) -> Iterator[Running]:
        return (running for running in self._running.values() if running.to is None)

    def cancel(self, call_id: CallId) -> None:
        """Give up a command; does nothing if it is not under way."""
        with self._lock:
            running = self._running.get(call_id)
        if running is not None:
            running.call.cancel()


def _cut(text: str) -> str:
    return text if len(text) <= _MOST_TEXT else f"{text[: _MOST_TEXT - 1]}…"
