"""The emulator of a Create 2: the Open Interface with any robot body.

Sensors that bodies lack, such as light bumpers, motor currents and infrared, read 0 or their idle value.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Final

from eal_actors.plugin import DataError

from . import packets
from .bodies import RoombaBody
from .emulated_roomba import AWAKE, LEADS_TO, Counter, EmulatedRoomba, power_of
from .groups import NO_REMOTE, bits
from .oi import BAUD_RATE, COUNTS, METRES_A_COUNT, MODES, SONGS, STREAM_PERIOD_S, WHEELBASE_M, OiLights, OiOp
from .sci import DATA_BYTES, MAX_SPEED_MM_S, MODE_PAUSE_S, STRAIGHT, Mode, Op

_CLIFF_SIGNAL: Final = 2600  # a floor of medium brightness
_ROUNDING_S: Final = 1e-9
_EXTRA_BYTES: Final[dict[int, int]] = {
    OiOp.RESET: 0,
    OiOp.PWM_MOTORS: 3,
    OiOp.DRIVE_DIRECT: 4,
    OiOp.DRIVE_PWM: 4,
    OiOp.STREAM: 1,
    OiOp.QUERY_LIST: 1,
    OiOp.STREAM_ON: 1,
    OiOp.SCHEDULING_LEDS: 2,
    OiOp.DIGITS_RAW: 4,
    OiOp.DIGITS_ASCII: 4,
    OiOp.PUSH_BUTTONS: 1,
    OiOp.SCHEDULE: 15,
    OiOp.SET_TIME: 3,
    OiOp.STOP: 0,
}


RESET_TEXT: Final = b"bl-start\r\nSTR730\r\nbootloader id: #x47186549 82ECCFFF\r\nbootloader info rev: #xF000\r\n"
"""The beginning of what a Create 2 prints after Reset."""


class OiEmulator(EmulatedRoomba):
    """A Create 2; see EmulatedRoomba."""

    data_bytes = MappingProxyType({**{op: DATA_BYTES.get(op, 0) for op in Op}, **_EXTRA_BYTES})
    accepted_in = MappingProxyType(
        {
            Op.START: frozenset(Mode),
            OiOp.RESET: frozenset(Mode),
            **dict.fromkeys((Op.BAUD, Op.CONTROL, Op.SAFE, Op.FULL, Op.SONG, Op.SENSORS), AWAKE),
            **dict.fromkeys((Op.POWER, Op.SPOT, Op.CLEAN, Op.MAX, Op.SEEK_DOCK), AWAKE),
            **dict.fromkeys((OiOp.STOP, OiOp.STREAM, OiOp.QUERY_LIST, OiOp.STREAM_ON, OiOp.PUSH_BUTTONS), AWAKE),
            **dict.fromkeys((OiOp.SCHEDULE, OiOp.SET_TIME), AWAKE),
        }
    )
    leads_to = MappingProxyType({**LEADS_TO, OiOp.RESET: Mode.OFF, OiOp.STOP: Mode.OFF, Op.SEEK_DOCK: Mode.PASSIVE})
    usual_baud_rate = BAUD_RATE
    most_songs = SONGS
    baud_keeps_mode = True
    straight = frozenset({STRAIGHT, 0x7FFF})

    def __init__(
        self,
        body: RoombaBody,
        mode_pause_s: float = MODE_PAUSE_S,
        *,
        wheelbase_m: float = WHEELBASE_M,
        has_device_detect: bool = False,
    ) -> None:
        super().__init__(body, mode_pause_s, has_device_detect=has_device_detect)
        self.wheelbase_m = wheelbase_m
        self.lights = OiLights()
        self.digits = b"    "
        self._velocity_mm_s, self._radius_mm = 0, 0
        self._streamed: tuple[int, ...] = ()
        self._streams = False
        self._streamed_s = -math.inf
        distance_mm, angle_deg = self._travel()
        self._distance, self._angle = Counter(distance_mm), Counter(angle_deg)

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Return the reply and the stream's frame that is due; see EmulatedRoomba."""
        reply = super().feed(data, now_s)
        if self.is_asleep or self.mode is Mode.OFF:
            self._streams = False
        if not self._streams or now_s < self._streamed_s + STREAM_PERIOD_S - _ROUNDING_S:
            return reply
        self._streamed_s = now_s  # one frame is enough: skipped ones would be equal
        return reply + packets.stream_frame(self._values(_packets(self._streamed), now_s), self._streamed)

    def _obey(self, op: int, data: bytes, now_s: float) -> bytes:
        reply = super()._obey(op, data, now_s)
        return RESET_TEXT if op == OiOp.RESET else reply

    def _more_bytes(self, op: int, begun: bytes | bytearray) -> int:
        return begun[1] if op in (OiOp.STREAM, OiOp.QUERY_LIST) else super()._more_bytes(op, begun)

    def _execute(self, op: int, data: bytes, now_s: float) -> bytes:
        if op == Op.SENSORS:
            return self._answer(data, now_s)
        if op == OiOp.QUERY_LIST:
            return self._answer(data[1:], now_s)
        if op == OiOp.STREAM:
            self._set_stream(data[1:])
        elif op == OiOp.STREAM_ON:
            self._streams = bool(data[0] & 1) and bool(self._streamed)
        elif op == OiOp.PWM_MOTORS:
            main, side, vacuum = struct.unpack(">bbb", data)
            self.brushes = (bool(side), bool(vacuum), bool(main))
        elif op == OiOp.DRIVE_DIRECT:
            self._drive_direct(*struct.unpack(">hh", data))
        elif op == OiOp.DRIVE_PWM:
            self._drive_direct(*(round(pwm / 255 * MAX_SPEED_MM_S) for pwm in struct.unpack(">hh", data)))
        elif op == Op.LEDS:
            debris, spot, dock, check = (bool(data[0] & 1 << bit) for bit in range(4))
            self.lights = OiLights(debris, spot, dock, check, data[1], data[2])
        elif op == OiOp.DIGITS_ASCII:
            self.digits = data
        return b""

    def _rest(self) -> None:
        super()._rest()
        self._velocity_mm_s = self._radius_mm = 0

    def _drive(self, velocity_mm_s: int, radius_mm: int) -> None:
        super()._drive(velocity_mm_s, radius_mm)
        self._velocity_mm_s, self._radius_mm = velocity_mm_s, radius_mm

    def _drive_direct(self, right_mm_s: int, left_mm_s: int) -> None:
        if max(abs(left_mm_s), abs(right_mm_s)) > MAX_SPEED_MM_S:
            self._refuse(f"Drive Direct at {left_mm_s} and {right_mm_s} mm/s")
            return
        self._set_wheels(left_mm_s / 1000, right_mm_s / 1000)

    def _set_stream(self, wanted: bytes) -> None:
        try:
            _packets(wanted)
        except DataError as error:
            self._refuse(error.message)
            return
        self._streamed = tuple(wanted)
        self._streams = bool(self._streamed)

    def _answer(self, wanted: bytes, now_s: float) -> bytes:
        try:
            values = self._values(_packets(wanted), now_s)
        except DataError as error:
            self._refuse(error.message)
            return b""
        return b"".join(packets.encode(packet, value) for packet, value in values.items())

    def _values(self, wanted: Iterable[int], now_s: float) -> dict[int, int]:
        known = {**self._felt(), **self._counted(), **self._own(now_s)}
        values = {}
        for packet in wanted:
            values[packet] = known.get(packet, 0)
            if packet == packets.DISTANCE:
                values[packet] = self._distance.take(self._travel()[0])
            elif packet == packets.ANGLE:
                values[packet] = self._angle.take(self._travel()[1])
        return values

    def _felt(self) -> Mapping[int, int]:
        """Return the packets of the body's sensors."""
        (bump_left, bump_right), (drop_left, drop_right, _) = self._body.bumps(), self._body.drops()
        cliffs, power = self._body.cliffs(), power_of(self._body)
        return {
            packets.BUMPS_AND_DROPS: bits(bump_right, bump_left, drop_right, drop_left),
            packets.OVERCURRENTS: bits(*[False] * 3, *[self._body.strained()] * 2),
            packets.WALL: int(self._body.wall()),
            **dict(zip(packets.CLIFFS, map(int, cliffs), strict=True)),
            **{
                packet: 0 if is_cliff else _CLIFF_SIGNAL
                for packet, is_cliff in zip(packets.CLIFF_SIGNALS, cliffs, strict=True)
            },
            17: NO_REMOTE,
            packets.CHARGING_STATE: power.charging_state,
            packets.VOLTAGE: power.voltage_mv,
            packets.CURRENT: power.current_ma,
            packets.TEMPERATURE: power.temperature_c,
            packets.CHARGE: power.charge_mah,
            packets.CAPACITY: power.capacity_mah,
        }

    def _counted(self) -> Mapping[int, int]:
        left_m, right_m = self._body.travel_m()
        return {
            packets.LEFT_COUNTS: math.floor(left_m / METRES_A_COUNT) % COUNTS,
            packets.RIGHT_COUNTS: math.floor(right_m / METRES_A_COUNT) % COUNTS,
            packets.STASIS: int(self._left_m_s + self._right_m_s > 0),
        }

    def _own(self, now_s: float) -> Mapping[int, int]:
        """Return the packets of its own state."""
        playing = self.playing(now_s)
        return {
            packets.BUTTONS: bits(*(name in self.pressed for name in packets.BUTTON_NAMES)),
            packets.OI_MODE: MODES.index(self.mode),
            packets.SONG_NUMBER: playing or 0,
            packets.SONG_PLAYING: int(playing is not None),
            packets.STREAM_PACKETS: len(self._streamed),
            packets.REQUESTED_VELOCITY: self._velocity_mm_s,
            packets.REQUESTED_RADIUS: self._radius_mm,
            packets.REQUESTED_RIGHT: round(self._right_m_s * 1000),
            packets.REQUESTED_LEFT: round(self._left_m_s * 1000),
        }

    def _travel(self) -> tuple[float, float]:
        """Return the distance in mm and the angle in degrees, in all, as the interface counts them."""
        left_m, right_m = self._body.travel_m()
        return (left_m + right_m) * 500, math.degrees((right_m - left_m) / self.wheelbase_m)


def _packets(numbers: Iterable[int]) -> tuple[int, ...]:
    return tuple(packet for number in numbers for packet in packets.packets_of(number))
