"""StateStore: the newest state of everything that a page shows, with the changes since any version.

CurrentSteps: the current steps of a run and the last error, by robot.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Final, Literal, TypeAlias

Kind: TypeAlias = Literal["robots", "poses", "run", "paths", "values"]
"""Kinds of cells: robots by name, the run under `""`, and poses, planned paths and live values by robot."""
Topic: TypeAlias = Literal["logs", "events"]
"""Topics of lines: the log, and the events of the run."""

MOST_LINES: Final[Mapping[Topic, int]] = {"logs": 1000, "events": 20_000}
"""How many lines are kept. Older lines are dropped, and counted for readers that missed them."""
MOST_AT_ONCE: Final = 400
"""Lines of a topic in one message."""


_JSON_TYPES: Final = frozenset({str, int, bool, type(None)})


def to_json_value(value: Any) -> Any:
    """Return a value that strict JSON can hold: None for NaN and infinity, the text of other objects."""
    if type(value) in _JSON_TYPES:  # first, because it is the most frequent of thousands of values a second
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, str | int):
        return value
    if isinstance(value, Mapping):
        return {str(key): to_json_value(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json_value(item) for item in value]
    return str(value)


class StateStore:
    """Cells, whose newest value counts, and topics of lines, of which each line counts.

    `on_change` is called after each change, in the thread that made it, and must not block. Thread: any; never blocks
    for longer than a copy of what changed.
    """

    def __init__(self) -> None:
        self.on_change: Callable[[], None] = lambda: None
        self._lock = threading.Lock()
        self._version = 0
        self._cells: dict[tuple[Kind, str], tuple[int, Any]] = {}
        # The values before their conversion to JSON. Comparing these saves most conversions, which cost more.
        self._raw: dict[Kind, dict[str, Any]] = {}
        self._lines: dict[Topic, deque[Any]] = {topic: deque(maxlen=most) for topic, most in MOST_LINES.items()}
        self._counts: dict[Topic, int] = dict.fromkeys(MOST_LINES, 0)

    def put(self, kind: Kind, values: Mapping[str, Any]) -> None:
        """Set cells to values, which the caller must not change afterwards. Unchanged values cost nothing.

        Thread: any, but one at a time for each kind.
        """
        raw = self._raw.setdefault(kind, {})
        fresh = {name: to_json_value(value) for name, value in values.items() if name not in raw or raw[name] != value}
        raw.update((name, values[name]) for name in fresh)
        with self._lock:
            changed = {
                name: value for name, value in fresh.items() if self._cells.get((kind, name), (0, None))[1] != value
            }
            if not changed:
                return
            self._version += 1
            for name, value in changed.items():
                self._cells[kind, name] = (self._version, value)
        self.on_change()

    def remove(self, kind: Kind, name: str) -> None:
        """Remove a cell, without telling browsers. Thread: as `put`."""
        self._raw.get(kind, {}).pop(name, None)
        with self._lock:
            self._cells.pop((kind, name), None)

    def append(self, topic: Topic, line: Mapping[str, Any]) -> None:
        """Add a line to a topic."""
        entry = to_json_value(line)
        with self._lock:
            self._lines[topic].append(entry)
            self._counts[topic] += 1
        self.on_change()

    def clear(self, topic: Topic) -> None:
        """Remove the lines of a topic, without counting them as dropped."""
        with self._lock:
            self._lines[topic].clear()

    def get(self, kind: Kind, name: str) -> Any:
        """Return the value of a cell, or None."""
        return self._cells.get((kind, name), (0, None))[1]

    def changes_since(self, version: int) -> tuple[int, dict[str, dict[str, Any]]]:
        """Return the current version, and the cells that changed after the given one, by kind and name."""
        with self._lock:
            changed: dict[str, dict[str, Any]] = {}
            for (kind, name), (written, value) in self._cells.items():
                if written > version:
                    changed.setdefault(kind, {})[name] = value
            return self._version, changed

    def lines_after(self, topic: Topic, count: int, most: int = MOST_AT_ONCE) -> tuple[int, list[Any], int]:
        """Return lines after the first `count` of a topic: the count at their end, the lines, and the number lost."""
        with self._lock:
            lines, total = self._lines[topic], self._counts[topic]
            first = total - len(lines)  # the number of the oldest line that is kept
            begin = max(count, first)
            chosen = [lines[number - first] for number in range(begin, min(total, begin + most))]
            return begin + len(chosen), chosen, begin - count


class StateReader:
    """The position of one browser in the store, at first before everything in it. Thread: one at a time."""

    def __init__(self, store: StateStore) -> None:
        self._store = store
        self._version = 0
        self._counts: dict[Topic, int] = {topic: store.lines_after(topic, 0, 0)[0] for topic in MOST_LINES}
        self.has_more = False

    def take(self) -> dict[str, Any]:
        """Return the changes since the last call; empty if there are none. Sets `has_more` if lines are left over."""
        self._version, changes = self._store.changes_since(self._version)
        update: dict[str, Any] = dict(changes)
        self.has_more = False
        for topic in MOST_LINES:
            self._counts[topic], lines, lost = self._store.lines_after(topic, self._counts[topic])
            if lines:
                update[topic] = lines
                self.has_more |= len(lines) == MOST_AT_ONCE
            if lost:
                update[f"{topic}_lost"] = lost
        return update


class CurrentSteps:
    """Keeps the steps that have started and not ended. Thread: any."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._steps: dict[str, dict[str, tuple[str, float]]] = {}
        self._errors: dict[str, str] = {}

    def start(self, robot: str, step: str, label: str, now_s: float) -> None:
        """Record the start of a step, by the fleet's clock."""
        with self._lock:
            self._steps.setdefault(robot, {})[step] = (label, now_s)

    def end(self, robot: str, step: str) -> None:
        """Record the end of a step."""
        with self._lock:
            self._steps.get(robot, {}).pop(step, None)

    def record_error(self, robot: str, error: str) -> None:
        """Replace the last error of a robot."""
        with self._lock:
            self._errors[robot] = error

    def clear(self) -> None:
        """End all steps."""
        with self._lock:
            self._steps.clear()

    def of(self, robot: str) -> dict[str, Any]:
        """Return the robot's newest step and its last error."""
        with self._lock:
            steps = list(self._steps.get(robot, {}).values())
            step = {"label": steps[-1][0], "since_s": steps[-1][1]} if steps else None
            return {"step": step, "last_error": self._errors.get(robot)}
