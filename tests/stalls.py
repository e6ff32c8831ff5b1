"""Stalls of the computer: times in which this process could not run.

Robots halt when their controller stalls, as they should, and a test of a real motion then fails. Such a result says
nothing about the code: tests/conftest.py repeats the test once, and the summary lists it.
"""

from __future__ import annotations

import threading
from typing import Final

from eal_actors.kernel.clock import ScaledClock

LIMIT_S: Final = 0.25
"""Dead-men of the tests wait 0.3 s or longer."""
_PERIOD_S: Final = 0.02


class StallWatch:
    """Measures by how much a thread wakes up too late. Thread: one of its own."""

    def __init__(self) -> None:
        self._longest_s = 0.0
        self._clock = ScaledClock()
        self._never = threading.Event()
        threading.Thread(target=self._run, name="stall watch", daemon=True).start()

    def _run(self) -> None:
        while True:
            begun_s = self._clock.now()
            self._never.wait(_PERIOD_S)
            self._longest_s = max(self._longest_s, self._clock.now() - begun_s - _PERIOD_S)

    def restart(self) -> None:
        """Forget all stalls."""
        self._longest_s = 0.0

    def has_stalled(self) -> bool:
        """Return whether a stall since the restart was long enough to halt a robot."""
        return self._longest_s >= LIMIT_S
