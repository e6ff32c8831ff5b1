"""The driver of a Roomba 4xx, over its Serial Command Interface."""

from __future__ import annotations

from collections.abc import Generator
from types import MappingProxyType
from typing import Final

from typing_extensions import override

from eal_actors.plugin import Clock, DataError

from . import sci
from .driver import RoombaDriver
from .gaps import TravelGaps
from .groups import GROUP_BYTES, Sensors
from .link import RoombaLink
from .listening import LOOK_S, until
from .motion import slowed
from .reading import RoombaReading, WheelCommand
from .sci import CLOCKWISE, COUNTER_CLOCKWISE, MAX_RADIUS_MM, STRAIGHT, WHEELBASE_M, Mode, Op

_REPLY_S: Final = 0.25
_REPLY_ON_A_LOSSY_WAY_S: Final = 0.1
_ASK: Final = sci.ask_sensors(0)


class SciDriver(RoombaDriver):
    """Drives a Roomba 4xx: it is polled, and each reading resets its counts of travel."""

    protocol = "sci"
    ways = MappingProxyType(
        {
            Mode.OFF: (Op.START, Mode.PASSIVE),
            Mode.PASSIVE: (Op.CONTROL, Mode.SAFE),
            Mode.SAFE: (Op.FULL, Mode.FULL),
        }
    )
    count_m = 0.001
    stop_data = sci.drive(0)

    def __init__(self, link: RoombaLink, clock: Clock, mode: Mode, poll_hz: float, name: str) -> None:
        super().__init__(link, clock, mode, poll_hz, name, WHEELBASE_M)
        self._asked_s = clock.now()
        self._reply = bytearray()
        self._gaps = TravelGaps()
        self._reply_s = _REPLY_ON_A_LOSSY_WAY_S if link.repeats > 1 else _REPLY_S

    @override
    def wheels(self, left_mm_s: int, right_mm_s: int) -> WheelCommand:
        if (left_mm_s < 0) == (right_mm_s < 0):  # no radius that Drive knows is as near to straight as two wheels are
            return self._drive(round((left_mm_s + right_mm_s) / 2), STRAIGHT)
        in_place = COUNTER_CLOCKWISE if right_mm_s > 0 else CLOCKWISE
        return self._drive(round(abs(right_mm_s - left_mm_s) / 2), in_place)

    @override
    def twist(self, speed_m_s: float, turn_rate_rad_s: float) -> WheelCommand:
        return self._drive(*twist_drive(speed_m_s, turn_rate_rad_s, self.calibration.track_factor))

    @staticmethod
    def _drive(velocity_mm_s: int, radius_mm: int) -> WheelCommand:
        left_m_s, right_m_s = sci.wheel_speeds_m_s(velocity_mm_s, radius_mm)
        return WheelCommand(sci.drive(velocity_mm_s, radius_mm), left_m_s, right_m_s)

    @property
    @override
    def travel_doubt_m(self) -> float:
        return self._gaps.doubt_m

    def _poll_once(self) -> Generator[float, None, bool]:
        yield from until(self._ask)
        while self.clock.now() - self._asked_s < self._reply_s:
            with self._lock:
                if self._take_bytes(self._link.receive()):
                    return True
            yield LOOK_S
        return False

    def _ask(self) -> float | None:
        with self._lock:
            if not self.is_due(self._quiet_until_s):
                return self._quiet_until_s - self.clock.now()
            self._take_bytes(self._link.receive())  # a late reply contains travel too
            self._reply.clear()
            self._link.send(_ASK, supersedes=True)
            self._asked_s = self.clock.now()
            self._gaps.ask(self._asked_s)
            return None

    def _take_bytes(self, data: bytes) -> bool:
        """Take bytes of a reply; returns whether it is complete. Thread: holds the lock."""
        self._reply += data
        is_taken = False
        while len(self._reply) >= (size := GROUP_BYTES[0]):
            try:
                sensors = Sensors.decode(bytes(self._reply[:size]))
            except DataError as error:  # noise on the line
                self._log.warning("a reply is dropped", reason=error.message)
                self._reply.clear()
                return False
            del self._reply[:size]
            self._take_sensors(sensors)
            is_taken = True
        return is_taken

    def _take_sensors(self, sensors: Sensors) -> None:
        controls = sensors.controls
        left_m = (controls.distance_mm - controls.angle_mm) / 1000
        right_m = (controls.distance_mm + controls.angle_mm) / 1000
        missing_left_m, missing_right_m = self._gaps.answer((left_m, right_m), self._commanded_m_s)
        if self._reading is not None:  # counts from before the first reading are not ours
            self._add_travel(left_m + missing_left_m, right_m + missing_right_m)
        self._take(
            RoombaReading(
                stamp_s=self._asked_s,
                contacts=sensors.contacts,
                power=sensors.power,
                pressed=controls.pressed,
                left_m=self._left_m,
                right_m=self._right_m,
                stands=controls.distance_mm == 0 and controls.angle_mm == 0,
            )
        )


def twist_drive(speed_m_s: float, turn_rate_rad_s: float, track_factor: float = 1.0) -> tuple[int, int]:
    """Return Drive's velocity in mm/s and radius in mm for a twist.

    A radius beyond 2 m is taken as 2 m or as straight, whichever is the nearer curve.

    Args:
        speed_m_s: forward positive.
        turn_rate_rad_s: counter-clockwise positive.
        track_factor: effective over nominal distance of the wheels.
    """
    speed_m_s, turn_rate_rad_s = slowed(speed_m_s, turn_rate_rad_s, WHEELBASE_M * track_factor)
    turn_rate_rad_s *= track_factor
    velocity_mm_s = round(speed_m_s * 1000)
    if abs(turn_rate_rad_s) * 2 * MAX_RADIUS_MM < abs(speed_m_s) * 1000:
        return velocity_mm_s, STRAIGHT
    radius_mm = speed_m_s / turn_rate_rad_s * 1000 if turn_rate_rad_s else 0.0
    if abs(radius_mm) < 1.5:  # 1 and -1 mean in place
        in_place = COUNTER_CLOCKWISE if turn_rate_rad_s > 0 else CLOCKWISE
        return round(abs(turn_rate_rad_s) * WHEELBASE_M / 2 * 1000), in_place
    return velocity_mm_s, round(max(-MAX_RADIUS_MM, min(MAX_RADIUS_MM, radius_mm)))
