"""What each robot is doing, as far as this process had it done, and its last error."""

from __future__ import annotations

import itertools
import threading
from typing import Any


class Doings:
    """Keeps what began and has not ended, by robot. Thread: any."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._numbers = itertools.count()
        self._running: dict[str, dict[object, tuple[str, float]]] = {}
        self._errors: dict[str, str] = {}

    def begin(self, robot: str, label: str, now_s: float, key: object = None) -> object:
        """Note that something begins, by the fleet's clock; returns the key by which it ends."""
        key = next(self._numbers) if key is None else key
        with self._lock:
            self._running.setdefault(robot, {})[key] = (label, now_s)
        return key

    def end(self, robot: str, key: object, error: str | None = None) -> None:
        """Note that it ended, and with what error if with any."""
        with self._lock:
            self._running.get(robot, {}).pop(key, None)
            if error:
                self._errors[robot] = error

    def fail(self, robot: str, error: str) -> None:
        """Note an error of the robot."""
        with self._lock:
            self._errors[robot] = error

    def forget_run(self) -> None:
        """End everything that began as a step of a run, whose keys are texts."""
        with self._lock:
            for running in self._running.values():
                for key in [key for key in running if isinstance(key, str)]:
                    del running[key]

    def of(self, robot: str) -> dict[str, Any]:
        """Return what runs, the newest last, and the last error."""
        with self._lock:
            running = [{"label": label, "since_s": since_s} for label, since_s in self._running.get(robot, {}).values()]
            return {"running": running, "last_error": self._errors.get(robot)}
