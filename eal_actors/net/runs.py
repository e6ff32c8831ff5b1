"""RunBoard: what a robot on the network is doing, as its greeting, its answers to pings and its events tell."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from eal_actors.actors.robot_view import RunningCommand
from eal_actors.device.resource import Progress
from eal_actors.kernel.errors import ProtocolError
from eal_actors.net.wire import CallId

_REMEMBERED: Final = 256
"""Commands that have ended, of which a word that was late on its way may still come."""


@dataclass(slots=True)
class _Row:
    running: RunningCommand
    told_s: float


class RunBoard:
    """The commands under way on one robot; times are the robot's real time. Thread: any."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._rows: dict[CallId, _Row] = {}
        self._ended: deque[CallId] = deque(maxlen=_REMEMBERED)

    def replace(self, told: object, as_of_s: float = math.inf) -> None:
        """Take in everything that runs.

        Args:
            told: rows of client, epoch, sequence and fields.
            as_of_s: the robot's time for which it holds; what began later stays listed.

        Raises:
            ProtocolError: it makes no sense.
        """
        try:
            rows = {
                CallId(str(client), int(epoch), int(sequence)): _Row(_running_from(fields), -math.inf)
                for client, epoch, sequence, fields in told  # type: ignore[attr-defined]  # checked by trying
            }
        except (TypeError, ValueError, AttributeError) as error:
            raise ProtocolError(f"the running commands {told!r} make no sense") from error
        with self._lock:
            later = {call_id: row for call_id, row in self._rows.items() if row.told_s > as_of_s}
            ended = set(self._ended)
            self._rows = {call_id: row for call_id, row in {**rows, **later}.items() if call_id not in ended}

    def begin(self, call_id: CallId, fields: Mapping[str, Any], told_s: float) -> None:
        """Take in that a command runs.

        Raises:
            ProtocolError: it makes no sense.
        """
        row = _Row(_running_from(fields), told_s)
        with self._lock:
            if call_id not in self._ended:
                self._rows[call_id] = row

    def advance(self, call_id: CallId, progress: Progress) -> None:
        """Take in how far it has come."""
        with self._lock:
            row = self._rows.get(call_id)
            if row is not None:
                running = row.running
                row.running = RunningCommand(running.resource, running.command, running.by, running.since_s, progress)

    def end(self, call_id: CallId) -> None:
        """Take in that it has ended."""
        with self._lock:
            self._rows.pop(call_id, None)
            self._ended.append(call_id)

    def clear(self) -> None:
        """Forget everything: the robot is out of reach."""
        with self._lock:
            self._rows.clear()

    def running(self, ours: Callable[[float], float]) -> tuple[RunningCommand, ...]:
        """Return what runs; `ours` makes our fleet's time of the robot's."""
        with self._lock:
            rows = [row.running for row in self._rows.values()]
        return tuple(_translated(running, ours) for running in rows)


def progress_from(told: object) -> Progress | None:
    """Read a progress: fraction, text and time; None where none is told.

    Raises:
        ProtocolError: it makes no sense.
    """
    if told is None:
        return None
    try:
        fraction, text, time_s = list(told)  # type: ignore[call-overload]  # checked by trying
        return Progress(None if fraction is None else float(fraction), str(text), float(time_s))
    except (TypeError, ValueError) as error:
        raise ProtocolError(f"the progress {told!r} makes no sense") from error


def translated_progress(progress: Progress, ours: Callable[[float], float]) -> Progress:
    """Return it with its time by our fleet's clock."""
    return Progress(progress.fraction, progress.text, ours(progress.time_s))


def _running_from(fields: Mapping[str, Any]) -> RunningCommand:
    try:
        resource, command, by = (str(fields[key]) for key in ("resource", "command", "by"))
        return RunningCommand(resource, command, by, float(fields["since_s"]), progress_from(fields.get("progress")))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ProtocolError(f"the running command {fields!r} makes no sense") from error


def _translated(running: RunningCommand, ours: Callable[[float], float]) -> RunningCommand:
    told = None if running.progress is None else translated_progress(running.progress, ours)
    return RunningCommand(running.resource, running.command, running.by, ours(running.since_s), told)
