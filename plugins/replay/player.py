"""The playback position of a record."""

from __future__ import annotations

from typing import Final

from eal_actors.plugin import Clock
from eal_actors.recording.recorded_run import RecordedRun


class Player:
    """Plays one record for all its robots. Its time starts at its creation and follows the fleet's clock.

    Thread: any.
    """

    def __init__(self, run: RecordedRun, clock: Clock, *, loop: bool) -> None:
        self.run: Final = run
        self._clock = clock
        self._loop = loop
        self._start_s = clock.now()

    @property
    def time_s(self) -> float:
        """Seconds since the run's start, in the record."""
        gone_s = self._clock.now() - self._start_s
        return gone_s % self.run.duration_s if self._loop and self.run.duration_s else gone_s

    def to_clock(self, time_s: float) -> float:
        """Return the fleet's clock time of the latest playback of a record time."""
        return self._clock.now() - (self.time_s - time_s)

    def over(self) -> str | None:
        """Return why the playback has ended; None during playback."""
        if self._loop or self.time_s <= self.run.duration_s:
            return None
        return f"the record ended at {self.run.duration_s:.3f} s"
