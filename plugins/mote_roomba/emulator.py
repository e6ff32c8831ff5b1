"""A Roomba at the other end of the wire: the Serial Command Interface over any body that can drive and feel.

It reads no clock and opens no port: whoever owns it hands it bytes and the time. So the same emulator stands behind
a pseudo-terminal, a socket or a simulated robot.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Final, Protocol

from .groups import GROUP_BYTES, Contacts, Controls, Power, Sensors
from .protocol import (
    BAUD_PAUSE_S,
    BAUD_RATES,
    CLOCKWISE,
    COUNTER_CLOCKWISE,
    DATA_BYTES,
    MAX_NOTES,
    MAX_RADIUS_MM,
    MAX_SPEED_MM_S,
    MODE_PAUSE_S,
    SONGS,
    STRAIGHT,
    WHEELBASE_M,
    Leds,
    Mode,
    Op,
    StatusLed,
)

_ROUNDING_S: Final = 1e-9


class BatteryReading(Protocol):
    """What a body's battery shows."""

    @property
    def voltage_v(self) -> float:
        """Voltage."""
        ...

    @property
    def current_a(self) -> float:
        """Current, negative while it is discharged."""
        ...

    @property
    def charge_ah(self) -> float:
        """What is left."""
        ...

    @property
    def capacity_ah(self) -> float:
        """What it holds when it is full."""
        ...

    @property
    def temperature_c(self) -> float:
        """Temperature."""
        ...


class Body(Protocol):
    """What the emulator needs of a robot's body, simulated or made up."""

    def drive(self, left_m_s: float, right_m_s: float) -> None:
        """Set the wheels' speeds until the next call; both 0 stops."""
        ...

    def travel_m(self) -> tuple[float, float]:
        """Return what the left and the right wheel's encoder have counted in all, forward positive."""
        ...

    def bumps(self) -> tuple[bool, bool]:
        """Return whether the left and the right bumper are pressed."""
        ...

    def drops(self) -> tuple[bool, bool, bool]:
        """Return whether the left wheel, the right wheel and the caster have dropped."""
        ...

    def cliffs(self) -> tuple[bool, bool, bool, bool]:
        """Return whether there is no floor under left, front left, front right and right."""
        ...

    def wall(self) -> bool:
        """Return whether there is something close to the right-hand side."""
        ...

    def battery(self) -> BatteryReading:
        """Return what the battery shows."""
        ...


_ANY: Final = frozenset(Mode)
_AWAKE: Final = frozenset({Mode.PASSIVE, Mode.SAFE, Mode.FULL})
_CONTROLLED: Final = frozenset({Mode.SAFE, Mode.FULL})
_ACCEPTED_IN: Final = {
    Op.START: _ANY,
    Op.BAUD: _AWAKE,
    Op.CONTROL: frozenset({Mode.PASSIVE}),
    Op.SAFE: frozenset({Mode.FULL}),
    Op.FULL: frozenset({Mode.SAFE}),
    Op.SONG: _AWAKE,
    Op.SENSORS: _AWAKE,
    Op.SEEK_DOCK: _ANY,
}
"""Where an op code is accepted; the others in safe and full mode."""
_LEADS_TO: Final = {
    Op.START: Mode.PASSIVE,
    Op.CONTROL: Mode.SAFE,
    Op.SAFE: Mode.SAFE,
    Op.FULL: Mode.FULL,
    Op.POWER: Mode.PASSIVE,
    Op.SPOT: Mode.PASSIVE,
    Op.CLEAN: Mode.PASSIVE,
    Op.MAX: Mode.PASSIVE,
}


@dataclass
class Buttons:
    """Which of the buttons are pressed; a test or a simulation sets them."""

    max: bool = False
    clean: bool = False
    spot: bool = False
    power: bool = False


class _Counter:
    """A travel in whole millimetres since it was read last; what is below one millimetre stays for the next time."""

    def __init__(self, total_m: float) -> None:
        self._taken_mm = total_m * 1000

    def take(self, total_m: float) -> int:
        """Return the millimetres since the last call, as many as the wire can carry, of a travel in all."""
        since_mm = math.trunc(round(total_m * 1000 - self._taken_mm, 6))
        self._taken_mm += since_mm
        return _clamped(since_mm, 16)


class RoombaEmulator:
    """The byte-level state machine.

    Args:
        body: what it drives and feels.
        mode_pause_s: how long it hears nothing after a change of its mode; 0 where the bytes come through an
            operating system, which delays them as it likes.

    Attributes:
        mode: the mode it is in.
        violations: bytes that came while it could not listen, and were lost.
        refused: commands that its mode did not allow, or whose data was out of range.
        baud_rate: the baud rate it was set to.
        lights: the lights as they were set last.
        songs: the notes of each song it keeps.
        buttons: the buttons as they are pressed.
        brushes: the cleaning motors: side brush, vacuum, main brush.

    Thread: its owner's; none of it blocks.
    """

    def __init__(self, body: Body, mode_pause_s: float = MODE_PAUSE_S) -> None:
        self.mode = Mode.OFF
        self.violations = 0
        self.refused = 0
        self.baud_rate = 57600
        self.lights = Leds()
        self.songs: dict[int, tuple[tuple[int, int], ...]] = {}
        self.buttons = Buttons()
        self.brushes = (False, False, False)
        self._body = body
        self._mode_pause_s = mode_pause_s
        self._deaf_until_s = -math.inf
        self._waiting = bytearray()
        self._left_m_s = self._right_m_s = 0.0
        distance_m, angle_m = self._travel_m()
        self._distance, self._angle = _Counter(distance_m), _Counter(angle_m)
        self._sings_until_s = -math.inf
        self._song: int | None = None

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Take bytes from the wire and return the reply to them.

        Args:
            data: any bytes, in pieces of any size.
            now_s: the time, which never goes backwards.
        """
        self.update()
        reply = bytearray()
        for byte in data:
            if now_s < self._deaf_until_s - _ROUNDING_S:
                self.violations += 1
                continue
            if not self._waiting and byte not in _OPS:
                self.refused += 1
                continue
            self._waiting.append(byte)
            if len(self._waiting) == self._wanted():
                op, values = Op(self._waiting[0]), bytes(self._waiting[1:])
                self._waiting.clear()
                reply += self._execute(op, values, now_s)
                self.update()
        return bytes(reply)

    def update(self) -> None:
        """Act by reflex: in safe mode, a dropped wheel, or a cliff on the way forward, ends the control."""
        if self.mode is not Mode.SAFE:
            return
        forward = self._left_m_s + self._right_m_s > 0
        if any(self._body.drops()) or (forward and any(self._body.cliffs())):
            self._enter(Mode.PASSIVE)

    def playing(self, now_s: float) -> int | None:
        """Return the number of the song that sounds, or None."""
        return self._song if now_s < self._sings_until_s else None

    def _wanted(self) -> int:
        """Return the length of the command that has begun to arrive."""
        op = Op(self._waiting[0])
        length = 1 + DATA_BYTES.get(op, 0)
        if op is Op.SONG and len(self._waiting) >= length:
            length += 2 * min(self._waiting[2], MAX_NOTES)
        return length

    def _execute(self, op: Op, data: bytes, now_s: float) -> bytes:
        if self.mode not in _ACCEPTED_IN.get(op, _CONTROLLED):
            self.refused += 1
            return b""
        if op is Op.SENSORS:
            return self._sensors(data[0])
        if op in _LEADS_TO:
            self._enter(_LEADS_TO[op])
            self._deaf_until_s = now_s + self._mode_pause_s
        elif op is Op.PLAY:
            self._play(data[0], now_s)
        elif op is Op.BAUD:
            self._set_baud(data[0], now_s)
        elif op is Op.DRIVE:
            self._drive(*struct.unpack(">hh", data))
        elif op is Op.MOTORS:
            self.brushes = (bool(data[0] & 1), bool(data[0] & 2), bool(data[0] & 4))
        elif op is Op.LEDS:
            dirt, max_, clean, spot = (bool(data[0] & 1 << bit) for bit in range(4))
            self.lights = Leds(dirt, max_, clean, spot, StatusLed(data[0] >> 4 & 3), data[1], data[2])
        elif op is Op.SONG:
            self._keep_song(data)
        return b""

    def _enter(self, mode: Mode) -> None:
        self.mode = mode
        if mode is Mode.PASSIVE:
            self.brushes = (False, False, False)
            self._set_wheels(0.0, 0.0)

    def _set_wheels(self, left_m_s: float, right_m_s: float) -> None:
        self._left_m_s, self._right_m_s = left_m_s, right_m_s
        self._body.drive(left_m_s, right_m_s)

    def _drive(self, velocity_mm_s: int, radius_mm: int) -> None:
        special = radius_mm == STRAIGHT
        if abs(velocity_mm_s) > MAX_SPEED_MM_S or radius_mm == 0 or (abs(radius_mm) > MAX_RADIUS_MM and not special):
            self.refused += 1
            return
        speed_m_s = velocity_mm_s / 1000
        if special:
            left = right = 1.0
        elif radius_mm in (CLOCKWISE, COUNTER_CLOCKWISE):
            left, right = -float(radius_mm), float(radius_mm)
        else:
            half = WHEELBASE_M / 2 / (radius_mm / 1000)
            left, right = 1 - half, 1 + half
        most = MAX_SPEED_MM_S / 1000
        fastest = max(abs(left), abs(right)) * abs(speed_m_s)
        scale = min(1.0, most / fastest) if fastest else 1.0  # a narrow curve at high speed is driven slower
        self._set_wheels(left * speed_m_s * scale, right * speed_m_s * scale)

    def _set_baud(self, code: int, now_s: float) -> None:
        if code >= len(BAUD_RATES):
            self.refused += 1
            return
        self.baud_rate = BAUD_RATES[code]
        self._enter(Mode.PASSIVE)
        if self._mode_pause_s:
            self._deaf_until_s = now_s + BAUD_PAUSE_S

    def _keep_song(self, data: bytes) -> None:
        number, notes = data[0], tuple(zip(data[2::2], data[3::2], strict=True))
        if number >= SONGS or not 1 <= data[1] <= MAX_NOTES or any(not 31 <= note <= 127 for note, _ in notes):
            self.refused += 1
            return
        self.songs[number] = notes

    def _play(self, number: int, now_s: float) -> None:
        if number not in self.songs or self.playing(now_s) is not None:
            self.refused += 1
            return
        self._song = number
        self._sings_until_s = now_s + sum(duration for _, duration in self.songs[number]) / 64

    def _sensors(self, group: int) -> bytes:
        if group >= len(GROUP_BYTES):
            self.refused += 1
            return b""
        if group == 1:
            return self._contacts().encode()
        if group == 2:
            return self._controls().encode()
        if group == 3:
            return self._power().encode()
        return Sensors(self._contacts(), self._controls(), self._power()).encode()

    def _contacts(self) -> Contacts:
        (bump_left, bump_right), (drop_left, drop_right, caster) = self._body.bumps(), self._body.drops()
        return Contacts(bump_right, bump_left, drop_right, drop_left, caster, self._body.wall(), *self._body.cliffs())

    def _controls(self) -> Controls:
        distance_m, angle_m = self._travel_m()
        pressed = self.buttons
        return Controls(
            button_max=pressed.max,
            button_clean=pressed.clean,
            button_spot=pressed.spot,
            button_power=pressed.power,
            distance_mm=self._distance.take(distance_m),
            angle_mm=self._angle.take(angle_m),
        )

    def _travel_m(self) -> tuple[float, float]:
        """Return distance and angle as the interface counts them, in metres in all."""
        left_m, right_m = self._body.travel_m()
        return (left_m + right_m) / 2, (right_m - left_m) / 2

    def _power(self) -> Power:
        battery = self._body.battery()
        return Power(
            voltage_mv=max(0, _clamped(battery.voltage_v * 1000, 17)),
            current_ma=_clamped(battery.current_a * 1000, 16),
            temperature_c=_clamped(battery.temperature_c, 8),
            charge_mah=max(0, _clamped(battery.charge_ah * 1000, 17)),
            capacity_mah=max(0, _clamped(battery.capacity_ah * 1000, 17)),
        )


_OPS: Final = frozenset(Op)


def _clamped(value: float, bits: int) -> int:
    """Return the nearest integer that a signed number of that many bits can hold."""
    most = 1 << (bits - 1)
    return max(-most, min(most - 1, round(value)))
