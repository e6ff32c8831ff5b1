"""Which steps of the run each robot is at, and its last error."""

from __future__ import annotations

import threading
from typing import Any


class Doings:
    """Keeps the steps that began and have not ended, by robot. Thread: any."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._steps: dict[str, dict[str, tuple[str, float]]] = {}
        self._errors: dict[str, str] = {}

    def begin(self, robot: str, step: str, label: str, now_s: float) -> None:
        """Note that a step begins, by the fleet's clock."""
        with self._lock:
            self._steps.setdefault(robot, {})[step] = (label, now_s)

    def end(self, robot: str, step: str) -> None:
        """Note that it ended."""
        with self._lock:
            self._steps.get(robot, {}).pop(step, None)

    def fail(self, robot: str, error: str) -> None:
        """Note an error of the robot."""
        with self._lock:
            self._errors[robot] = error

    def forget_run(self) -> None:
        """End all steps."""
        with self._lock:
            self._steps.clear()

    def of(self, robot: str) -> dict[str, Any]:
        """Return the newest step, and the last error."""
        with self._lock:
            steps = list(self._steps.get(robot, {}).values())
            step = {"label": steps[-1][0], "since_s": steps[-1][1]} if steps else None
            return {"step": step, "last_error": self._errors.get(robot)}
