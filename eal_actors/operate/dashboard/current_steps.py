"""The current steps of a run and the last error, by robot."""

from __future__ import annotations

import threading
from typing import Any


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
