"""The driver of a Roomba with the Open Interface, whose sensors come in a stream."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from types import MappingProxyType
from typing import Final

from typing_extensions import override

from eal_actors.plugin import Clock

from . import oi, packets
from .driver import RoombaDriver
from .groups import CHARGING_STATES, Contacts, PowerGroup
from .link import RoombaLink
from .listening import LOOK_S
from .motion import MAX_SPEED_MM_S, slowed
from .oi import COUNTS, METRES_A_COUNT, MODES, STREAM_PERIOD_S
from .reading import RoombaReading, WheelCommand
from .sci import Mode, Op

STREAMED: Final = (
    packets.BUMPS_AND_DROPS,
    packets.WALL,
    *packets.CLIFFS,
    packets.VIRTUAL_WALL,
    packets.OVERCURRENTS,
    packets.BUTTONS,
    packets.CHARGING_STATE,
    packets.VOLTAGE,
    packets.CURRENT,
    packets.TEMPERATURE,
    packets.CHARGE,
    packets.CAPACITY,
    packets.OI_MODE,
    packets.LEFT_COUNTS,
    packets.RIGHT_COUNTS,
)
"""The streamed packets; a frame of them takes 4 of the 15 ms."""

_REPLY_S: Final = 0.1
_UNDER_WAY_S: Final = 0.004  # a frame of the stream
_STREAM: Final = oi.stream(STREAMED)
_PAUSE: Final = oi.stream_on(on=False)
_ROLL_OUT_M: Final = 0.1  # what a wheel may travel beyond its highest speed between two readings


class OiDriver(RoombaDriver):
    """Drives a Roomba that streams its sensors, reports its mode, and never resets its encoders."""

    protocol = "oi"
    ways = MappingProxyType(
        {
            Mode.OFF: (Op.START, Mode.PASSIVE),
            Mode.PASSIVE: (Op.SAFE, Mode.SAFE),
            Mode.SAFE: (Op.FULL, Mode.FULL),
        }
    )
    count_m = METRES_A_COUNT
    stop_data = oi.drive_direct(0, 0)

    def __init__(
        self, link: RoombaLink, clock: Clock, mode: Mode, poll_hz: float, name: str, wheelbase_m: float
    ) -> None:
        super().__init__(link, clock, mode, poll_hz, name, wheelbase_m)
        self._reader = packets.StreamReader()
        self._counts: tuple[int, int] | None = None
        self._interruption: str | None = None

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
        frames = [frame for frame in self._reader.feed(data) if frame.keys() >= set(STREAMED)]
        if frames:  # the latest has it all, as the encoders count on
            self._take_values(frames[-1])
        return bool(frames)

    def _take_values(self, values: Mapping[int, int]) -> None:
        stamp_s = self.clock.now() - STREAM_PERIOD_S - _UNDER_WAY_S
        left_m, right_m = self._travelled_m(values, stamp_s)
        if self._reading is not None:
            self._add_travel(left_m, right_m)
        self._take(
            RoombaReading(
                stamp_s=stamp_s,
                contacts=_contacts(values),
                power=_power(values),
                pressed=_pressed(values),
                left_m=self._left_m,
                right_m=self._right_m,
                stands=left_m == right_m == 0,
            )
        )
        if self.is_due(self._quiet_until_s + STREAM_PERIOD_S) and stamp_s >= self._quiet_until_s:
            self._note_reported_mode(values[packets.OI_MODE])

    def _note_reported_mode(self, number: int) -> None:
        mode = MODES[number] if number < len(MODES) else Mode.OFF
        if mode is self._mode:
            return
        if any(self._commanded_m_s) and mode not in (Mode.SAFE, Mode.FULL):
            self._interruption = f"the Roomba has left its {self._wanted.value} mode: a button, the charger, or a drop"
        self._mode, self._sent_count = mode, 0

    def _travelled_m(self, values: Mapping[int, int], stamp_s: float) -> tuple[float, float]:
        """Return what the wheels travelled since the reading before."""
        counts = values[packets.LEFT_COUNTS], values[packets.RIGHT_COUNTS]
        before, self._counts = self._counts, counts
        if before is None or self._reading is None:
            return 0.0, 0.0
        left, right = (
            (now - then + COUNTS // 2) % COUNTS - COUNTS // 2 for now, then in zip(counts, before, strict=True)
        )
        most_m = _ROLL_OUT_M + MAX_SPEED_MM_S / 1000 * (stamp_s - self._reading.stamp_s)
        if max(abs(left), abs(right)) * METRES_A_COUNT > most_m:
            self._log.warning("the encoders were reset; the travel in between is unknown")
            return 0.0, 0.0
        return left * METRES_A_COUNT, right * METRES_A_COUNT

    def _stop(self) -> None:
        super()._stop()
        self._interruption = None


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
