"""The common base of the drivers: modes, readings and travel, shared by several resources."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Generator, Mapping
from typing import ClassVar, Final

from eal_actors.plugin import (
    Activity,
    Clock,
    NotReadyError,
    ResourceFaultError,
    UnavailableError,
)

from .link import RoombaLink
from .listening import LOOK_S, Listener, until
from .predicted_wheels import Travel
from .reading import RoombaReading, WheelCommand
from .sci import MAX_NOTES, MODE_PAUSE_S, Mode, Op

_MODE_PAUSE_S: Final = MODE_PAUSE_S + 0.002  # clocks differ
_WAKE_TRIES: Final = 3
_INSIST_S: Final = 0.1  # a stop without an effect is repeated after this time
_OBEYED_S: Final = 0.06  # a stop counts as obeyed if the wheels stand after this time
_STIRRED_S: Final = 1.5  # wheels that turn, however slowly, count twice within this time
_LOOK_AGAIN_S: Final = 0.05
_DISOBEYED_S: Final = 0.3  # wheels that do not begin to turn meanwhile have not heard their command
_DETECT_HIGH_S: Final = 0.1
_DETECT_LOW_S: Final = 0.5
_WAKE_UP_S: Final = 3.0
_LOSSY_ACCELERATION_M_S2: Final = 0.3  # less than that of the wheels, so that a lost command or count matters little
_FAREWELL_S: Final = 0.5
_START: Final = bytes([Op.START])
_STOPS_A_START: Final = 6
_STARTS: Final = _START * (2 * MAX_NOTES + 4)
"""More than the longest command, Song. Start ends control, and with it every motion."""


class RoombaDriver(Listener):
    """Commands and readings over one link, for several resources with their own threads.

    Args:
        mode: the mode to drive in: safe or full.
        poll_hz: readings a second.
        name: the robot's name, for frames.
        wheelbase_m: nominal distance of its wheels.

    Attributes:
        has_checksums: whether the link has, so that it loses bytes but passes no wrong ones on.
        acceleration_m_s2: of the commanded speeds of a motion; infinite on a link that loses little.

    Thread: any; one lock, which is never held during a wait.
    """

    ways: ClassVar[Mapping[Mode, tuple[int, Mode]]]
    """From each mode, the op code that leads to the next, and that mode."""
    count_m: ClassVar[float]
    """Resolution of the encoders."""
    stop_data: ClassVar[bytes]
    """The bytes that stop the wheels."""

    def __init__(
        self, link: RoombaLink, clock: Clock, mode: Mode, poll_hz: float, name: str, wheelbase_m: float
    ) -> None:
        super().__init__(link, clock, poll_hz, name, wheelbase_m)
        self.has_checksums: Final = link.repeats > 1
        self.acceleration_m_s2: Final = _LOSSY_ACCELERATION_M_S2 if self.has_checksums else math.inf
        self._wanted = mode
        self._mode = Mode.OFF  # as far as is known
        self._quiet_until_s = clock.now()
        self._commanded_m_s = (0.0, 0.0)  # the left and the right wheel
        self._sent_count = 0  # how often the command to the next mode was sent
        self._goes_forward = False
        self._greeted = 0
        self._is_asleep = False
        self._is_driven = False
        self._must_stand = False
        self._must_repeat = False
        self._stop_count = 0
        self._drive_data = b""
        self._stopped_s = self._sent_s = self._driven_s = clock.now()

    # Differences between the protocols.

    @abstractmethod
    def wheels(self, left_mm_s: int, right_mm_s: int) -> WheelCommand:
        """Return the command for two speeds that are equal, or opposite."""

    @abstractmethod
    def twist(self, speed_m_s: float, turn_rate_rad_s: float) -> WheelCommand:
        """Return the command for a twist; if a wheel would be too fast, drive the same curve slower."""

    @abstractmethod
    def _poll_once(self) -> Generator[float, None, bool]:
        """Request a reading; return whether it arrived."""

    # Life.

    def wake(self) -> Activity:
        """Enter the driving mode and take the first reading; a silent Roomba is no error."""
        for _ in range(_WAKE_TRIES * self._link.repeats):
            if self._link.why_not_ready() is not None:
                return
            try:
                self._forget_state()
                yield from self._enter(self._wanted)
                if (yield from self._poll_once()):
                    return
            except UnavailableError as error:
                self._note_trouble(error.message)

    def not_ready(self) -> str | None:
        """Return why it cannot be used now: the link is absent, or the Roomba sleeps or is silent."""
        if self._is_asleep:
            return "the Roomba sleeps; the command wake of its resource Power wakes it"
        return self.silence()

    def fall_asleep(self) -> Activity:
        """Stop it and put it to sleep, as its button does; only `wake_up` works then."""
        self.stop()
        yield from self.command(bytes([Op.POWER]))
        with self._lock:
            self._is_asleep, self._is_driven = True, False
            self._note_mode(Mode.OFF)

    def wake_up(self) -> Activity:
        """Wake it by the device detect line, if connected, and start its interface.

        Raises:
            NotReadyError: it does not answer.
        """
        try:
            for low, hold_s in ((False, _DETECT_HIGH_S), (True, _DETECT_LOW_S)):
                self._link.pull_device_detect(low=low)
                yield hold_s
        finally:
            self._link.pull_device_detect(low=False)
        with self._lock:
            self._is_asleep = False
            self._greeted = -1  # the poller starts the interface again
        begun_s = self.clock.now()
        while (reading := self._reading) is None or reading.stamp_s < begun_s:
            if self.clock.now() - begun_s > _WAKE_UP_S:
                raise NotReadyError(self.silence() or f"the Roomba on {self._link.name} does not wake up")
            yield self.period_s

    @property
    def interruption(self) -> str | None:
        """Why the Roomba itself ended the latest motion, if it reports that; None if it did not."""
        return None

    @property
    def travel_doubt(self) -> Travel:
        """Error bound of the total travel due to lost and damaged readings; it only grows."""
        return Travel(0.0, 0.0)

    @property
    def is_asleep(self) -> bool:
        """Whether it was put to sleep."""
        return self._is_asleep

    @property
    def mode(self) -> Mode:
        """Its last known mode."""
        return self._mode

    def release(self) -> None:
        """Stop it and release it into passive mode, if it can be reached."""
        with self._lock:
            if self._link.why_not_ready() is None and not self._is_asleep:
                self._stop()
                self._is_driven = False
                self._link.send(_START)
                self._note_mode(Mode.PASSIVE)

    def farewell(self) -> Activity:
        """Release the Roomba again if a command took control after the release, and wait until it is sent."""
        try:
            if self._mode in (Mode.SAFE, Mode.FULL):
                self.release()
            yield from self._flush()
        except UnavailableError as error:
            self._log.warning("the Roomba may not have been released", reason=error.message)

    def _flush(self) -> Activity:
        """Wait until everything is sent; on a lossy link, repeat it."""
        if self._link.why_not_ready() is not None:
            return
        begun_s, repeats = self.clock.now(), self._link.repeats - 1
        while (self._link.is_busy or repeats > 0) and self.clock.now() - begun_s < _FAREWELL_S:
            with self._lock:
                self._link.receive()
            if not self._link.is_busy and repeats > 0:
                self.release()
                repeats -= 1
            yield LOOK_S

    def close(self) -> None:
        """Close the link."""
        with self._lock:
            self._link.close()

    # Commands.

    def command(self, data: bytes) -> Activity:
        """Send a command; enter the driving mode first if necessary.

        Raises:
            ResourceFaultError: a wheel has dropped, and safe mode takes no command then.
            UnavailableError: it does not answer, or the link is broken.
        """
        yield from until(lambda: self._try_command(data))

    def drive(self, drive: WheelCommand) -> Activity:
        """Send a command to the wheels, see `command`."""
        yield from until(lambda: self._try_command(drive.data, drive))

    def stop(self) -> None:
        """Stop the wheels at once, in any mode; the poller repeats it until they stand.

        Raises:
            UnavailableError: the link is broken, and it may be moving.
        """
        with self._lock:
            may_move = any(self._commanded_m_s) or self._must_stand
            if may_move or self._link.why_not_ready() is None:
                self._stop()

    def doubt(self) -> None:
        """Note that it ignores commands: the next command sets its mode again."""
        with self._lock:
            self._mode = Mode.PASSIVE

    def _stop(self) -> None:
        now_s = self.clock.now()
        self._goes_forward = False
        self._must_stand, self._stopped_s, self._stop_count = True, now_s, 0
        self._send_stop(now_s)

    def _send_stop(self, now_s: float) -> None:
        """Send a stop; one without an effect may be swallowed by a damaged command, up to the longest one's end."""
        self._sent_s = now_s
        self._stop_count += 1
        self._note_wheels(0.0, 0.0)
        if self._stop_count % _STOPS_A_START:
            self._link.urge(self.stop_data)
        else:
            self._link.urge(_STARTS)
            self._note_mode(Mode.PASSIVE)

    def _note_wheels(self, left_m_s: float, right_m_s: float) -> None:
        """Note a command to the wheels. Thread: holds the lock."""
        self._commanded_m_s = (left_m_s, right_m_s)
        self._must_repeat = False

    def _try_command(self, data: bytes, drive: WheelCommand | None = None) -> float | None:
        """Send a command, or do the next step towards it and return the delay until the following step."""
        contacts = self.latest_in_motion().contacts
        if contacts.any_drop and self._wanted is Mode.SAFE:
            raise ResourceFaultError(
                "a wheel has dropped: in safe mode the Roomba takes no command until it stands again"
            )
        with self._lock:
            if (delay_s := self._mode_step(self._wanted)) is not None:
                return delay_s
            self._link.send(data, supersedes=drive is not None)
            if drive is not None:
                self._is_driven, self._goes_forward = True, drive.goes_forward
                self._must_stand, self._drive_data, self._sent_s = False, data, self.clock.now()
                if not any(self._commanded_m_s):
                    self._driven_s = self._sent_s
                self._note_wheels(drive.left_m_s, drive.right_m_s)
            return None

    def _enter(self, wanted: Mode) -> Activity:
        """Enter a mode step by step."""

        def step() -> float | None:
            with self._lock:
                return self._mode_step(wanted)

        yield from until(step)

    def _mode_step(self, wanted: Mode) -> float | None:
        """Do the next mode change towards the wanted mode; return the delay after it, or None at the end."""
        if not self.is_due(self._quiet_until_s):
            return self._quiet_until_s - self.clock.now()
        if self._mode is wanted or self._mode not in self.ways:
            return None
        op, mode = self.ways[self._mode]
        self._link.send(bytes([op]))
        self._sent_count += 1
        self._note_mode(mode if self._sent_count >= self._link.repeats else self._mode)
        return _MODE_PAUSE_S

    def _note_mode(self, mode: Mode) -> None:
        if mode is not self._mode:
            self._mode, self._sent_count = mode, 0
        self._quiet_until_s = self.clock.now() + _MODE_PAUSE_S

    # Polling.

    def _poll_turn(self) -> Activity:
        if self._is_asleep or self._link.why_not_ready() is not None:
            return
        if self._link.openings != self._greeted:
            self._forget_state()
            yield from self._enter(Mode.PASSIVE)
        if (yield from self._poll_once()):
            self._trouble = None
        else:
            yield from self._restart_if_silent()
        yield from self._repeat_command()

    def _forget_state(self) -> None:
        """Reset the state: the Roomba may be another one, or have been switched off and on."""
        with self._lock:
            self._greeted = self._link.openings
            self._link.receive()
            self._mode = Mode.OFF

    def _restart_if_silent(self) -> Activity:
        reading = self._reading
        if reading is not None and self.clock.now() - reading.stamp_s <= self._silence_s:
            return
        self._log.debug("no answer; the interface is restarted", port=self._link.name)
        with self._lock:
            self._mode = Mode.OFF
        yield from self._enter(Mode.PASSIVE)

    def _repeat_command(self) -> Activity:
        """Repeat a stop until a reading confirms it, and a command to the wheels that they do not obey."""
        with self._lock:
            reading = self._reading
            if self._must_stand or not any(self._commanded_m_s):
                self._repeat_stop(reading)
                return
            if reading is None or self._has_fallen(reading) or not self._is_disobeyed(reading):
                return
        yield from self._enter(self._wanted)
        with self._lock:
            if any(self._commanded_m_s):
                self._link.send(self._drive_data, supersedes=True)
                self._sent_s = self.clock.now()
                self._note_wheels(*self._commanded_m_s)

    def _repeat_stop(self, reading: RoombaReading | None) -> None:
        """Repeat a stop until a reading confirms it. Thread: holds the lock."""
        now_s = self.clock.now()
        if not self._must_stand:
            if self._is_driven:  # whatever its mode: that is an inference
                self._watch_rest(now_s)
        elif reading is not None and reading.stands and reading.stamp_s - self._stopped_s > _OBEYED_S:
            self._must_stand, self._stopped_s, self._stop_count = False, reading.stamp_s, 0
        elif now_s - self._sent_s > _INSIST_S:
            self._send_stop(now_s)

    def _watch_rest(self, now_s: float) -> None:
        """Stop wheels that stood and have counted twice since: a damaged byte has set them going.

        A single count may be a damaged reading, and a needless stop is a risk: damaged, it is a drive.
        """
        if self._moved_before_s > max(self._stopped_s, self._moved_s - _STIRRED_S):
            self._stop()
        elif self._moved_s > max(self._stopped_s, now_s - _STIRRED_S):
            self._next_poll_s = now_s + _LOOK_AGAIN_S

    def _is_disobeyed(self, reading: RoombaReading) -> bool:
        """Return whether the wheels may not have heard their command. Thread: holds the lock."""
        if reading.stands and reading.stamp_s - max(self._moved_s, self._driven_s) > _DISOBEYED_S:
            self._driven_s = self.clock.now()
            if self._mode is self._wanted:
                self._mode = Mode.PASSIVE  # a damaged command may have ended its control
            return True
        return self._must_repeat

    def _take(self, reading: RoombaReading) -> None:
        """Note a reading. Thread: holds the lock."""
        self._reading = reading
        if self._mode is Mode.SAFE and self._has_fallen(reading):
            self._mode = Mode.PASSIVE

    def _has_fallen(self, reading: RoombaReading) -> bool:
        """Return whether there is a cause to end safe mode."""
        contacts = reading.contacts
        falls = contacts.any_drop or (contacts.any_cliff and self._goes_forward)
        return falls or reading.power.is_charging
