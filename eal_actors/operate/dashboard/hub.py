"""Hub: the newest state of everything that a page shows, and what each browser has not seen of it yet."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final, Literal, TypeAlias

Kind: TypeAlias = Literal["robots", "poses", "run"]
"""What cells are of: robots by name, their poses by name, and the run under `""`."""
Topic: TypeAlias = Literal["logs", "events"]
"""What lines are of: the log, and the events of the run."""

MOST_LINES: Final[Mapping[Topic, int]] = {"logs": 1000, "events": 20_000}
"""How many lines are kept; older ones are dropped, and counted for those who have not read them."""
MOST_AT_ONCE: Final = 400
"""Lines of a topic in one message."""


_PLAIN: Final = frozenset({str, int, bool, type(None)})


def plain(value: Any) -> Any:
    """Return a value as JSON has it everywhere: what is no finite number becomes None, other objects their text."""
    if type(value) in _PLAIN:  # as most are, and as is looked at thousands of times a second
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, str | int):
        return value
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return str(value)


class Hub:
    """Keeps cells, of which the newest value counts, and lines, of which each counts.

    Args:
        on_change: called after each change, in the thread that made it; it must not block.

    Thread: any; never blocks for longer than a copy of what changed.
    """

    def __init__(self, on_change: Callable[[], None] = lambda: None) -> None:
        self.on_change = on_change
        self._lock = threading.Lock()
        self._version = 0
        self._cells: dict[tuple[Kind, str], tuple[int, Any]] = {}
        self._given: dict[Kind, dict[str, Any]] = {}  # the same before it was made plain, which costs more
        self._lines: dict[Topic, deque[Any]] = {topic: deque(maxlen=most) for topic, most in MOST_LINES.items()}
        self._counts: dict[Topic, int] = dict.fromkeys(MOST_LINES, 0)

    def put(self, kind: Kind, values: Mapping[str, Any]) -> None:
        """Take in the state of some cells, which must not change afterwards; those that are as they were cost nothing.

        Thread: any, but one at a time for each kind.
        """
        given = self._given.setdefault(kind, {})
        fresh = {name: plain(value) for name, value in values.items() if name not in given or given[name] != value}
        given.update((name, values[name]) for name in fresh)
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

    def tell(self, topic: Topic, line: Mapping[str, Any]) -> None:
        """Add a line to a topic."""
        entry = plain(line)
        with self._lock:
            self._lines[topic].append(entry)
            self._counts[topic] += 1
        self.on_change()

    def clear(self, topic: Topic) -> None:
        """Forget the lines of a topic, which nobody misses."""
        with self._lock:
            self._lines[topic].clear()

    def get(self, kind: Kind, name: str) -> Any:
        """Return the state of a cell, or None."""
        return self._cells.get((kind, name), (0, None))[1]

    def since(self, version: int) -> tuple[int, dict[str, dict[str, Any]]]:
        """Return the cells that changed after a version, by kind and name, and the version that they make up."""
        with self._lock:
            changed: dict[str, dict[str, Any]] = {}
            for (kind, name), (written, value) in self._cells.items():
                if written > version:
                    changed.setdefault(kind, {})[name] = value
            return self._version, changed

    def lines_after(self, topic: Topic, count: int, most: int = MOST_AT_ONCE) -> tuple[int, list[Any], int]:
        """Return lines after the first `count` of a topic: how many there are up to their end, they, and those lost."""
        with self._lock:
            lines, total = self._lines[topic], self._counts[topic]
            first = total - len(lines)  # the number of the oldest line that is there still
            begin = max(count, first)
            chosen = [lines[number - first] for number in range(begin, min(total, begin + most))]
            return begin + len(chosen), chosen, begin - count


class Reader:
    """What one browser has seen, which is all that the hub's side keeps of it.

    Args:
        hub: the hub; the first message holds all that it keeps.

    Thread: one at a time.
    """

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._version = 0
        self._counts: dict[Topic, int] = {topic: hub.lines_after(topic, 0, 0)[0] for topic in MOST_LINES}
        self.has_more = False

    def take(self) -> dict[str, Any]:
        """Return what is new since the last time; empty if nothing is. `has_more` tells that lines are left over."""
        self._version, message = self._hub.since(self._version)
        news: dict[str, Any] = dict(message)
        self.has_more = False
        topics: Iterable[Topic] = MOST_LINES
        for topic in topics:
            self._counts[topic], lines, lost = self._hub.lines_after(topic, self._counts[topic])
            if lines:
                news[topic] = lines
                self.has_more |= len(lines) == MOST_AT_ONCE
            if lost:
                news[f"{topic}_lost"] = lost
        return news
