"""The driver of a Roomba with the Open Interface, whose sensors come in a stream."""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping
from types import MappingProxyType
from typing import Final

from typing_extensions import override

from eal_actors.plugin import Activity, Clock, DataError

from . import oi, packets
from .driver import RoombaDriver
from .echo import CommandEcho
from .groups import CHARGING_STATES, Contacts, PowerGroup
from .link import RoombaLink
from .listening import LOOK_S
from .motion import MAX_SPEED_MM_S, slowed
from .oi import COUNTS, METRES_A_COUNT, MODES, STREAM_PERIOD_S
from .predicted_wheels import NOTHING, Travel
from .reading import WheelCommand
from .sci import NO_OP_CODE, Mode, Op

_REQUESTED: Final = (
    packets.CONTACTS_GROUP,
    packets.BUTTONS,
    packets.POWER_GROUP,
    packets.OI_MODE,
    packets.REQUESTED_RIGHT,
    packets.REQUESTED_LEFT,
    packets.LEFT_COUNTS,
    packets.RIGHT_COUNTS,
)
"""Numbers of the streamed packets and groups; a frame takes 4 of the 15 ms.

The contacts come as a group: the number of their first packet is the op code of Reset, which the Roomba obeys if a byte
before it is lost.
"""
STREAMED: Final = tuple(packet for number in _REQUESTED for packet in packets.packets_of(number))
"""The packets in a frame."""

_REPLY_S: Final = 0.1
_UNDER_WAY_S: Final = 0.005  # a frame of the stream
_STREAM: Final = oi.stream(_REQUESTED)
_PAUSE: Final = oi.stream_on(on=False)
_ROLL_OUT_M: Final = 0.005  # what a wheel may travel beyond its highest speed between two readings
_PUSHED_S: Final = 0.5  # between two frames further apart, a wheel turns by commands alone
_MOST_TRAVEL_M: Final = COUNTS // 2 * METRES_A_COUNT  # beyond, the counts are ambiguous
_RETAKE_S: Final = 1.0  # control that ends without a visible cause is taken back, but not twice within this time
_SILENT_S: Final = 0.2  # without a frame in a motion, the interface is started again


class OiDriver(RoombaDriver):
    """Drives a Roomba that streams its sensors, reports its mode, and never resets its encoders."""

    ways = MappingProxyType(
        {
            Mode.OFF: (Op.START, Mode.PASSIVE),
            Mode.PASSIVE: (Op.SAFE, Mode.SAFE),
            Mode.SAFE: (Op.FULL, Mode.FULL),
        }
    )
    count_m = METRES_A_COUNT
    stop_data = oi.drive_direct(0, 0) + bytes([NO_OP_CODE])
    """The last byte completes a stop that has lost one, which would take the next op code for the speed of a wheel."""

    def __init__(
        self, link: RoombaLink, clock: Clock, mode: Mode, poll_hz: float, name: str, wheelbase_m: float
    ) -> None:
        super().__init__(link, clock, mode, poll_hz, name, wheelbase_m)
        self._reader = packets.StreamReader(_REQUESTED)
        self._latest: Mapping[int, int] | None = None
        self._latest_s = 0.0
        self._unusual: Mapping[int, int] | None = None
        self._echo = CommandEcho()
        self._interruption: str | None = None
        self._doubt = NOTHING
        self._retaken_s = -math.inf

    @override
    def wheels(self, left_mm_s: int, right_mm_s: int) -> WheelCommand:
        return WheelCommand(oi.drive_direct(left_mm_s, right_mm_s), left_mm_s / 1000, right_mm_s / 1000)

    @override
    def twist(self, speed_m_s: float, turn_rate_rad_s: float) -> WheelCommand:
        track_m = self.wheelbase_m * self.calibration.track_factor
        speed_m_s, turn_rate_rad_s = slowed(speed_m_s, turn_rate_rad_s, track_m)
        left_m_s, right_m_s = self.calibration.counted(speed_m_s, turn_rate_rad_s * self.wheelbase_m / 2)
        return self.wheels(_reached(left_m_s), _reached(right_m_s))

    @property
    @override
    def interruption(self) -> str | None:
        return self._interruption

    @property
    @override
    def travel_doubt(self) -> Travel:
        return self._doubt

    @property
    @override
    def _longest_period_s(self) -> float:
        """A frame tells the delay of the line, as long as it does not wait to be read."""
        return STREAM_PERIOD_S if any(self._commanded_m_s) or self._must_stand else math.inf

    @property
    @override
    def delay_s(self) -> float:
        return self._echo.delay_s

    @property
    @override
    def lag_s(self) -> float:
        return self._echo.lag_s(self.clock.now())

    @override
    def _note_wheels(self, left_m_s: float, right_m_s: float) -> None:
        super()._note_wheels(left_m_s, right_m_s)
        self._echo.sent((round(left_m_s * 1000), round(right_m_s * 1000)), self.clock.now())

    def release(self) -> None:
        """Stop it and leave it to itself, in passive mode and without a stream, if it can be reached."""
        super().release()
        with self._lock:
            if self._link.why_not_ready() is None and not self._is_asleep:
                self._link.send(_PAUSE)

    def _poll_once(self) -> Generator[float, None, bool]:
        begun_s = self.clock.now()
        if (reading := self._reading) is None or begun_s - reading.stamp_s > _REPLY_S + self.period_s:
            with self._lock:
                self._link.send(_STREAM)
        while True:
            with self._lock:
                if self._take_bytes(self._link.receive()):
                    return True
            if self.clock.now() - begun_s >= _REPLY_S:
                return False
            yield LOOK_S

    def _take_bytes(self, data: bytes) -> bool:
        """Take bytes of the stream; returns whether they end a frame. Thread: holds the lock."""
        frames = [frame for frame in self._reader.feed(data) if tuple(frame) == STREAMED and self._is_plausible(frame)]
        if frames:  # the latest has it all, as the encoders count on
            self._take_values(frames[-1])
        return bool(frames)

    def _is_plausible(self, values: Mapping[int, int]) -> bool:
        """Return whether a frame follows the one before; an unusual one is believed if the next confirms it."""
        before = self._latest
        if before is None or self._follows(values, before, self.clock.now() - self._latest_s):
            self._unusual = None
            return _is_possible(values)
        unusual, self._unusual = self._unusual, values
        return unusual is not None and _is_possible(values) and self._follows(values, unusual, STREAM_PERIOD_S)

    def _follows(self, values: Mapping[int, int], before: Mapping[int, int], duration_s: float) -> bool:
        """Return whether the wheels and the battery can have changed so between two frames."""
        return self._can_have_turned(values, before, duration_s) and _power(values).follows(_power(before))

    def _can_have_turned(self, values: Mapping[int, int], before: Mapping[int, int], duration_s: float) -> bool:
        """Return whether the wheels can have turned so between two frames, by the commands that it may have obeyed.

        A Roomba that was switched off meanwhile counts from 0, another one from anywhere.
        """
        speeds_mm_s = (0, 0), (before[packets.REQUESTED_LEFT], before[packets.REQUESTED_RIGHT]), *self._echo.unshown
        spare_m, driven_s = _most_m(min(duration_s, _PUSHED_S)), max(duration_s - _PUSHED_S, 0.0)
        for travel_m, wheel_mm_s in zip(_counted_m(values, before), zip(*speeds_mm_s, strict=True), strict=True):
            least_m, most_m = (speed_mm_s / 1000 * driven_s for speed_mm_s in (min(wheel_mm_s), max(wheel_mm_s)))
            if not least_m - spare_m <= travel_m <= most_m + spare_m or most_m - least_m > _MOST_TRAVEL_M:
                return False
        return True

    def _take_values(self, values: Mapping[int, int]) -> None:
        now_s = self.clock.now()
        left_m, right_m = self._travelled_m(values, now_s)
        self._echo.heard((values[packets.REQUESTED_LEFT], values[packets.REQUESTED_RIGHT]), now_s)
        if self._echo.is_overdue(now_s):
            self._must_repeat = True
        stamp_s = now_s - max(STREAM_PERIOD_S + _UNDER_WAY_S, self._echo.lag_s(now_s))
        self._latest, self._latest_s = values, now_s
        if self._reading is not None:
            self._add_travel(left_m, right_m)
        has_turned = bool(left_m or right_m)
        self._take(self._reading_of(stamp_s, _contacts(values), _power(values), _pressed(values), has_turned))
        if self.is_due(self._quiet_until_s + STREAM_PERIOD_S) and stamp_s >= self._quiet_until_s:
            self._note_reported_mode(values[packets.OI_MODE])

    def _note_reported_mode(self, number: int) -> None:
        mode = MODES[number]
        if mode is self._mode or self._echo.is_open(self.clock.now()):
            return
        self._mode, self._sent_count = mode, 0
        if not any(self._commanded_m_s) or mode in (Mode.SAFE, Mode.FULL) or self._reading is None:
            return
        now_s, has_cause = self.clock.now(), bool(self._reading.pressed) or self._has_fallen(self._reading)
        if has_cause or now_s - self._retaken_s < _RETAKE_S:
            self._interruption = f"the Roomba has left its {self._wanted.value} mode: a button, the charger, or a drop"
        else:  # a damaged command has ended its control
            self._retaken_s, self._must_repeat = now_s, True

    def _restart_if_silent(self) -> Activity:
        if any(self._commanded_m_s) and self._reading is not None:
            if self.clock.now() - self._latest_s < _SILENT_S:  # whatever the delay of the line
                return
            with self._lock:
                self._mode, self._must_repeat = Mode.OFF, True
            return
        yield from super()._restart_if_silent()

    def _travelled_m(self, values: Mapping[int, int], now_s: float) -> tuple[float, float]:
        """Return what the wheels travelled since the reading before."""
        if self._latest is None or self._reading is None:
            return 0.0, 0.0
        if not self._can_have_turned(values, self._latest, now_s - self._latest_s):
            self._log.warning("the encoders were reset; the travel in between is unknown")
            if any(self._commanded_m_s):
                self._interruption = "the Roomba has reset its encoders, and its travel meanwhile is unknown"
            most_m = _most_m(now_s - self._latest_s)
            self._doubt = self._doubt.plus(Travel(most_m, most_m))
            return 0.0, 0.0
        return _counted_m(values, self._latest)

    def _stop(self) -> None:
        super()._stop()
        self._interruption = None


def _counted_m(values: Mapping[int, int], before: Mapping[int, int]) -> tuple[float, float]:
    """Return the travel of the left and the right wheel between two frames; the counts wrap."""
    left, right = (
        (values[packet] - before[packet] + COUNTS // 2) % COUNTS - COUNTS // 2
        for packet in (packets.LEFT_COUNTS, packets.RIGHT_COUNTS)
    )
    return left * METRES_A_COUNT, right * METRES_A_COUNT


def _most_m(duration_s: float) -> float:
    """Return what a wheel can travel between two frames; a delayed one may be counted late."""
    return _ROLL_OUT_M + MAX_SPEED_MM_S / 1000 * (duration_s + STREAM_PERIOD_S)


def _is_possible(values: Mapping[int, int]) -> bool:
    """Return whether all values are in their ranges."""
    try:
        _power(values).check()
    except DataError:
        return False
    speeds = values[packets.REQUESTED_LEFT], values[packets.REQUESTED_RIGHT]
    return values[packets.OI_MODE] < len(MODES) and max(map(abs, speeds)) <= MAX_SPEED_MM_S


def _reached(speed_m_s: float) -> int:
    return max(-MAX_SPEED_MM_S, min(MAX_SPEED_MM_S, round(speed_m_s * 1000)))


def _flag(values: Mapping[int, int], packet: int, bit: int = 0) -> bool:
    return bool(values[packet] >> bit & 1)


def _contacts(values: Mapping[int, int]) -> Contacts:
    return Contacts(
        bump_right=_flag(values, packets.BUMPS_AND_DROPS, 0),
        bump_left=_flag(values, packets.BUMPS_AND_DROPS, 1),
        drop_right=_flag(values, packets.BUMPS_AND_DROPS, 2),
        drop_left=_flag(values, packets.BUMPS_AND_DROPS, 3),
        wall=_flag(values, packets.WALL),
        cliff_left=_flag(values, packets.CLIFFS[0]),
        cliff_front_left=_flag(values, packets.CLIFFS[1]),
        cliff_front_right=_flag(values, packets.CLIFFS[2]),
        cliff_right=_flag(values, packets.CLIFFS[3]),
        virtual_wall=_flag(values, packets.VIRTUAL_WALL),
        overcurrent_side_brush=_flag(values, packets.OVERCURRENTS, 0),
        overcurrent_main_brush=_flag(values, packets.OVERCURRENTS, 2),
        overcurrent_drive_right=_flag(values, packets.OVERCURRENTS, 3),
        overcurrent_drive_left=_flag(values, packets.OVERCURRENTS, 4),
    )


def _power(values: Mapping[int, int]) -> PowerGroup:
    state = values[packets.CHARGING_STATE]
    return PowerGroup(
        charging_state=state if state < len(CHARGING_STATES) else len(CHARGING_STATES) - 1,
        voltage_mv=values[packets.VOLTAGE],
        current_ma=values[packets.CURRENT],
        temperature_c=values[packets.TEMPERATURE],
        charge_mah=values[packets.CHARGE],
        capacity_mah=values[packets.CAPACITY],
    )


def _pressed(values: Mapping[int, int]) -> frozenset[str]:
    return frozenset(name for bit, name in enumerate(packets.BUTTON_NAMES) if _flag(values, packets.BUTTONS, bit))
