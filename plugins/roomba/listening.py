"""The latest reading of a Roomba, its age, and the total travel."""

from __future__ import annotations

import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Final

from eal_actors.plugin import Activity, Clock, Localizer, NotReadyError, UnavailableError, WheelCalibration, get_logger

from .groups import Contacts, PowerGroup
from .link import RoombaLink
from .odometry import DeadReckoning
from .reading import RoombaReading

POLLS_A_READING_LASTS: Final = 3
"""Maximum age of a valid reading, in polls."""
READING_LASTS_S: Final = 0.5
"""Age up to which a reading is valid in any case: single ones may be lost on their way."""
LOOK_S: Final = 0.004  # how often to look whether a reply is complete; 26 bytes take 5 ms at 57600 baud

_SILENCE_S: Final = 1.0  # until the interface is started again: the Roomba may have been switched off and on
_ROUNDING_S: Final = 1e-6
_SLICE_S: Final = 0.05
_MOST_LAG_S: Final = 1.0
_STANDS_S: Final = 0.045  # without a count; wheels at the slowest speed of a motion count twice meanwhile


def until(step: Callable[[], float | None]) -> Activity:
    """Repeat a step that returns how long to wait for the next one, until it returns None."""
    while (delay_s := step()) is not None:
        yield delay_s


class Listener(ABC):
    """Readings over a link, for several resources with their own threads. Exactly one of them polls.

    Args:
        poll_hz: readings a second.
        name: the robot's name, for frames.
        wheelbase_m: nominal distance of its wheels.

    Attributes:
        localizer: receives the pose by odometry with each reading.

    Thread: any; one lock, which is never held during a wait.
    """

    def __init__(self, link: RoombaLink, clock: Clock, poll_hz: float, name: str, wheelbase_m: float) -> None:
        self.clock: Final = clock
        self.name: Final = name
        self.period_s: Final = 1.0 / poll_hz
        self.wheelbase_m: Final = wheelbase_m
        self.calibration = WheelCalibration()
        self._link = link
        self.localizer = Localizer(name)
        self._lock = threading.Lock()
        self._reading: RoombaReading | None = None
        self._odometry = DeadReckoning(wheelbase_m)
        self._path = DeadReckoning(wheelbase_m)
        self._moved_s = self._moved_before_s = -math.inf  # the latest count of the wheels, and the one before
        self._first_s = clock.now()
        self._next_poll_s: float | None = None
        self._left_m = self._right_m = 0.0
        self._trouble: str | None = None
        self._unanswered_count = 0  # turns of the poller since the latest reading
        self._log = get_logger(robot=name)

    def is_due(self, time_s: float) -> bool:
        """Return whether a time has come, within 1 us: a stepped clock may end a wait too early by rounding."""
        return self.clock.now() >= time_s - _ROUNDING_S

    def unreachable(self) -> str | None:
        """Return why the link is broken; None if it works."""
        return self._link.why_not_ready()

    def silence(self) -> str | None:
        """Return why it does not answer; None if it does, or if the silence is short."""
        if (reason := self._link.why_not_ready()) is not None:
            return reason
        reading = self._reading
        if reading is None:
            why = f" ({self._trouble})" if self._trouble else ""
            hint = "is the Roomba on and connected, and is the baud rate right?"
            return f"nothing answers on {self._link.name}{why}: {hint}"
        is_old = self.clock.now() - reading.stamp_s > self._silence_s
        return self._too_old(reading) if is_old and self._was_asked else None

    @property
    def _was_asked(self) -> bool:
        """Whether it can be silent: a computer that was held up has not asked meanwhile."""
        return self._unanswered_count >= POLLS_A_READING_LASTS

    def latest_in_motion(self) -> RoombaReading:
        """Return the latest reading, also an old one if this computer was held up; the next one is on its way then.

        Raises:
            UnavailableError: it is too old, though it was asked for.
        """
        reading = self._reading
        is_expected = reading is not None and not self._was_asked and self._link.why_not_ready() is None
        return reading if reading is not None and is_expected else self.latest()

    def latest(self) -> RoombaReading:
        """Return the latest reading.

        Raises:
            UnavailableError: it is too old.
        """
        reading = self._reading
        if reading is None:
            raise NotReadyError(self.silence() or f"the Roomba on {self._link.name} has not been read yet")
        if self.clock.now() - reading.stamp_s > self._lasts_s:
            if (reason := self._link.why_not_ready()) is not None:
                raise NotReadyError(reason)
            raise UnavailableError(self._too_old(reading))
        return reading

    @property
    def _lasts_s(self) -> float:
        lasts_s = max(POLLS_A_READING_LASTS * self.period_s, self._link.reading_lasts_s, READING_LASTS_S)
        return lasts_s + min(self.lag_s, _MOST_LAG_S)

    @property
    @abstractmethod
    def delay_s(self) -> float:
        """Measured delay of the line, from a request or a command to what shows its effect; 0 until it is known."""

    @property
    def lag_s(self) -> float:
        """The delay of the line as it may be now."""
        return self.delay_s

    @property
    def _longest_period_s(self) -> float:
        """Longest time between polls now, whatever the settings say."""
        return math.inf

    @property
    def _silence_s(self) -> float:
        """After this time without a reading, the interface is started again."""
        return max(_SILENCE_S, self._lasts_s)

    def _too_old(self, reading: RoombaReading) -> str:
        age_s, why = self.clock.now() - reading.stamp_s, f" ({self._trouble})" if self._trouble else ""
        if not self._was_asked:
            return f"this program was held up, and has not read the Roomba on {self._link.name} for {age_s:.2f} s"
        return (
            f"the Roomba on {self._link.name} does not answer{why}: its last reading is {age_s:.2f} s old, "
            f"and counts for {self._lasts_s:.2f} s"
        )

    def next_look_s(self) -> float:
        """Return how long to wait for the reading after the latest one, more than 0."""
        reading = self._reading
        due_s = self.period_s - (self.clock.now() - reading.stamp_s) if reading is not None else 0.0
        return max(due_s + LOOK_S / 2, LOOK_S)

    def located(self) -> tuple[float, tuple[float, float, float]]:
        """Return the latest reading's time, and the pose by dead reckoning then: x in m, y in m, yaw in rad.

        Raises:
            UnavailableError: see `latest`.
        """
        with self._lock:
            return self.latest().stamp_s, self._odometry.pose

    def place(self, x_m: float, y_m: float, yaw_rad: float) -> None:
        """Set the pose."""
        with self._lock:
            self._odometry.place(x_m, y_m, yaw_rad)
            if self._reading is not None:
                self.localizer.restart_odometry(x_m, y_m, yaw_rad, self._reading.stamp_s)

    def poll(self) -> Activity:
        """Poll forever, in spite of link errors. Only one caller may do so."""
        while True:
            begun_s, self._next_poll_s, before = self.clock.now(), None, self._reading
            try:
                yield from self._poll_turn()
            except UnavailableError as error:  # polling is retried; calls report the error meanwhile
                self._note_trouble(error.message)
            self._unanswered_count = self._unanswered_count + 1 if self._reading is before else 0
            while not self.is_due(due_s := self._due_s(begun_s)):
                left_s = due_s - self.clock.now()
                yield min(left_s, LOOK_S if self._link.is_busy else _SLICE_S)
                self._serve_link()

    def _due_s(self, begun_s: float) -> float:
        """Return when the next poll is due, after one that began at a time; a motion may begin meanwhile."""
        due_s = begun_s + min(self.period_s, self._longest_period_s)
        return due_s if self._next_poll_s is None else min(due_s, self._next_poll_s)

    def _serve_link(self) -> None:
        """Let the link send its queue."""
        if self._link.is_busy:
            with self._lock:
                try:
                    self._take_bytes(self._link.receive())
                except UnavailableError as error:
                    self._trouble = error.message

    @abstractmethod
    def _take_bytes(self, data: bytes) -> object:
        """Process bytes received between two polls. Thread: holds the lock."""

    @abstractmethod
    def _poll_turn(self) -> Activity:
        """Take one reading, and do the other due work.

        Raises:
            UnavailableError: the link is broken.
        """

    def _add_travel(self, left_m: float, right_m: float) -> None:
        """Add the encoders' counts. Thread: holds the lock."""
        self._left_m += left_m
        self._right_m += right_m
        ahead_m, arc_m = self.calibration.travelled(left_m, right_m)
        for reckoning in (self._odometry, self._path):
            reckoning.add(ahead_m - arc_m, ahead_m + arc_m)

    def _reading_of(
        self, stamp_s: float, contacts: Contacts, power: PowerGroup, pressed: frozenset[str], has_turned: bool
    ) -> RoombaReading:
        """Return a reading, after its travel was added. Thread: holds the lock."""
        if self._reading is None:
            self._first_s = stamp_s
        self.localizer.odometry(*self._odometry.pose, stamp_s)
        if has_turned:
            self._moved_before_s, self._moved_s = self._moved_s, stamp_s
        stands = stamp_s - max(self._moved_s, self._first_s) >= _STANDS_S
        return RoombaReading(stamp_s, contacts, power, pressed, self._left_m, self._right_m, stands, self._path.pose)

    def _note_trouble(self, trouble: str) -> None:
        if trouble != self._trouble:
            self._log.warning("the Roomba cannot be reached", reason=trouble)
        self._trouble = trouble
