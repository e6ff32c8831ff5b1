"""The one Roomba that a plugin's resources share: its modes, its readings and its travel."""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Final

from eal_actors.plugin import Activity, Clock, DataError, ResourceFaultError, UnavailableError, get_logger

from . import protocol
from .groups import GROUP_BYTES, Sensors
from .link import Link
from .odometry import DeadReckoning
from .protocol import Mode, Op

POLLS_A_READING_LASTS: Final = 3
"""How many polls old a reading may become before it is no answer any more."""

_MODE_PAUSE_S: Final = protocol.MODE_PAUSE_S + 0.002  # a little longer, as clocks differ
_LOOK_S: Final = 0.004  # how often to look whether a reply is complete; 26 bytes take 5 ms at 57600 baud
_REPLY_S: Final = 0.25
_WAKE_TRIES: Final = 3
_SILENCE_S: Final = 1.0  # after which it may have been switched off and on, and is started anew
_ROUNDING_S: Final = 1e-6
_CHARGING: Final = (1, 2, 3)
_ASK: Final = protocol.ask_sensors(0)
_STOP: Final = protocol.drive(0)
_NEXT: Final = {
    Mode.OFF: (Op.START, Mode.PASSIVE),
    Mode.PASSIVE: (Op.CONTROL, Mode.SAFE),
    Mode.SAFE: (Op.FULL, Mode.FULL),
}
"""From each mode, the command that leads to the next, and that mode."""


@dataclass(frozen=True, slots=True)
class Reading:
    """One reply to Sensors.

    Attributes:
        stamp_s: when it was asked for, in seconds of the fleet's clock.
        sensors: what it said.
        left_m: the left wheel's travel in all.
        right_m: the right wheel's travel in all.
    """

    stamp_s: float
    sensors: Sensors
    left_m: float
    right_m: float

    @property
    def stands(self) -> bool:
        """Whether neither wheel has turned since the reading before it."""
        return self.sensors.controls.distance_mm == 0 and self.sensors.controls.angle_mm == 0


def _until(step: Callable[[], float | None]) -> Activity:
    """Repeat a step that returns how long to wait for the next one, until it returns None."""
    while (delay_s := step()) is not None:
        yield delay_s


class Roomba:
    """Commands and readings over one link, for several resources in threads of their own.

    Exactly one of them polls, because a reading resets the distance and the angle that it reports.

    Args:
        link: the way to it.
        clock: the fleet's clock.
        mode: the mode to drive in: safe or full.
        poll_hz: readings a second.
        name: the robot's name, for frames.

    Thread: any; one lock, which is never held during a wait.
    """

    def __init__(self, link: Link, clock: Clock, mode: Mode, poll_hz: float, name: str) -> None:
        self.clock: Final = clock
        self.name: Final = name
        self.period_s: Final = 1.0 / poll_hz
        self._link = link
        self._lock = threading.Lock()
        self._wanted = mode
        self._mode = Mode.OFF  # as far as is known: the interface does not tell
        self._quiet_until_s = clock.now()
        self._asked_s = clock.now()
        self._reply = bytearray()
        self._reading: Reading | None = None
        self._odometry = DeadReckoning(protocol.WHEELBASE_M)
        self._goes_forward = False
        self._log = get_logger(robot=name)

    def is_due(self, time_s: float) -> bool:
        """Return whether a time has come, to a microsecond: a clock that steps may end a wait a rounding too early."""
        return self.clock.now() >= time_s - _ROUNDING_S

    # Life.

    def wake(self) -> Activity:
        """Bring it into the mode to drive in, and read it for the first time.

        Raises:
            UnavailableError: nothing answers, or the link is broken.
        """
        for _ in range(_WAKE_TRIES):
            with self._lock:
                self._mode = Mode.OFF
            yield from self._enter(self._wanted)
            if (yield from self._poll_once()):
                return
        raise UnavailableError(
            f"nothing answers on {self._link.name}: is the Roomba on and connected, and is the baud rate right?"
        )

    def release(self) -> None:
        """Stop it and leave it to itself, in passive mode."""
        with self._lock:
            self._stop()
            self._link.send(protocol.plain(Op.START))
            self._note_mode(Mode.PASSIVE)

    def close(self) -> None:
        """Let go of the link, and of the Roomba if a command took control after its release."""
        try:
            if self._mode in (Mode.SAFE, Mode.FULL):
                self.release()
        finally:
            with self._lock:
                self._link.close()

    # Commands.

    def command(self, data: bytes) -> Activity:
        """Send a command as soon as the Roomba is in the mode to drive in; it is brought there if need be.

        Raises:
            ResourceFaultError: a wheel has dropped, and safe mode takes no command then.
            UnavailableError: it does not answer, or the link is broken.
        """
        yield from _until(lambda: self._try_command(data))

    def drive(self, velocity_mm_s: int, radius_mm: int) -> Activity:
        """Send Drive, see protocol.drive and `command`."""
        data = protocol.drive(velocity_mm_s, radius_mm)
        forward = velocity_mm_s > 0 and radius_mm not in (protocol.CLOCKWISE, protocol.COUNTER_CLOCKWISE)
        yield from _until(lambda: self._try_command(data, forward=forward))

    def stop(self) -> None:
        """Send Drive 0 whatever the mode, and at once: a byte that is lost does less harm than a late stop.

        Raises:
            UnavailableError: the link is broken.
        """
        with self._lock:
            self._stop()

    def doubt(self) -> None:
        """Note that it does not do as it is told: the next command brings it into its mode anew."""
        with self._lock:
            self._mode = Mode.PASSIVE

    def _stop(self) -> None:
        self._goes_forward = False
        self._link.send(_STOP)

    def _try_command(self, data: bytes, *, forward: bool | None = None) -> float | None:
        """Send a command, or do the next step towards it and return the wait until the one after it."""
        contacts = self.latest().sensors.contacts
        if contacts.any_drop and self._wanted is Mode.SAFE:
            raise ResourceFaultError(
                "a wheel has dropped: in safe mode the Roomba takes no command until it stands again"
            )
        with self._lock:
            if (delay_s := self._mode_step(self._wanted)) is not None:
                return delay_s
            if forward is not None:
                self._goes_forward = forward
            self._link.send(data)
            return None

    def _enter(self, wanted: Mode) -> Activity:
        """Bring it into a mode from one further away."""

        def step() -> float | None:
            with self._lock:
                return self._mode_step(wanted)

        yield from _until(step)

    def _mode_step(self, wanted: Mode) -> float | None:
        """Go one mode further towards the wanted one; return the wait after it, None when nothing is left to do."""
        if not self.is_due(self._quiet_until_s):
            return self._quiet_until_s - self.clock.now()
        if self._mode is wanted or self._mode not in _NEXT:
            return None
        op, mode = _NEXT[self._mode]
        self._link.send(protocol.plain(op))
        self._note_mode(mode)
        return _MODE_PAUSE_S

    def _note_mode(self, mode: Mode) -> None:
        self._mode = mode
        self._quiet_until_s = self.clock.now() + _MODE_PAUSE_S

    # Readings.

    def latest(self) -> Reading:
        """Return the latest reading.

        Raises:
            UnavailableError: it is older than three polls.
        """
        reading, now_s = self._reading, self.clock.now()
        limit_s = POLLS_A_READING_LASTS * self.period_s
        if reading is None:
            raise UnavailableError(f"the Roomba on {self._link.name} has not been read yet")
        if (age_s := now_s - reading.stamp_s) > limit_s:
            raise UnavailableError(
                f"the Roomba on {self._link.name} does not answer: its last reading is {age_s:.2f} s old, "
                f"and counts for {limit_s:.2f} s"
            )
        return reading

    def next_look_s(self) -> float:
        """Return how long to wait for the reading after the latest one, more than 0."""
        reading = self._reading
        due_s = self.period_s - (self.clock.now() - reading.stamp_s) if reading is not None else 0.0
        return max(due_s + _LOOK_S / 2, _LOOK_S)

    def located(self) -> tuple[float, tuple[float, float, float]]:
        """Return the latest reading's time, and the pose by dead reckoning then: x in m, y in m, yaw in rad.

        Raises:
            UnavailableError: see `latest`.
        """
        with self._lock:
            return self.latest().stamp_s, self._odometry.pose

    def place(self, x_m: float, y_m: float, yaw_rad: float) -> None:
        """Say where it is."""
        with self._lock:
            self._odometry.place(x_m, y_m, yaw_rad)

    def poll(self) -> Activity:
        """Read it again and again, for ever. Only one may do so.

        Raises:
            UnavailableError: the link is broken.
        """
        while True:
            begun_s = self.clock.now()
            if not (yield from self._poll_once()):
                yield from self._start_anew_if_silent()
            yield max(0.0, begun_s + self.period_s - self.clock.now())

    def _start_anew_if_silent(self) -> Activity:
        longest_s = max(_SILENCE_S, POLLS_A_READING_LASTS * self.period_s)  # from then on no command comes between
        if self._reading is not None and self.clock.now() - self._reading.stamp_s <= longest_s:
            return
        self._log.debug("no answer; the interface is started anew", port=self._link.name)
        with self._lock:
            self._mode = Mode.OFF
        yield from self._enter(Mode.PASSIVE)

    def _poll_once(self) -> Generator[float, None, bool]:
        """Ask for a reading and wait for it; returns whether it came."""
        yield from _until(self._ask)
        while self.clock.now() - self._asked_s < _REPLY_S:
            if self._take_reply():
                return True
            yield _LOOK_S
        return False

    def _ask(self) -> float | None:
        with self._lock:
            if not self.is_due(self._quiet_until_s):
                return self._quiet_until_s - self.clock.now()
            self._link.receive()  # what is left of a reply that was given up
            self._reply.clear()
            self._link.send(_ASK)
            self._asked_s = self.clock.now()
            return None

    def _take_reply(self) -> bool:
        with self._lock:
            self._reply += self._link.receive()
            if len(self._reply) < GROUP_BYTES[0]:
                return False
            try:
                sensors = Sensors.decode(bytes(self._reply))
            except DataError as error:  # two replies at once, or noise on the line
                self._log.warning("a reply is dropped, and with it what it said of the travel", reason=error.message)
                self._reply.clear()
                return False
            self._take(sensors)
            return True

    def _take(self, sensors: Sensors) -> None:
        distance_mm, angle_mm = sensors.controls.distance_mm, sensors.controls.angle_mm
        self._odometry.add((distance_mm - angle_mm) / 1000, (distance_mm + angle_mm) / 1000)
        self._reading = Reading(self._asked_s, sensors, self._odometry.left_m, self._odometry.right_m)
        contacts = sensors.contacts
        falls = contacts.any_drop or (contacts.any_cliff and self._goes_forward)
        if self._mode is Mode.SAFE and (falls or sensors.power.charging_state in _CHARGING):
            self._mode = Mode.PASSIVE
