"""A Roomba at the other end of the wire: the Serial Command Interface over any body that can drive and feel.

It reads no clock and opens no port: whoever owns it hands it bytes and the time. So the same emulator stands behind
a pseudo-terminal, a socket or a simulated robot. As a program it is a Roomba on an endless floor:

    python -m plugins.mote_roomba.emulator --pty [--pace] [--mote] [--loss 0.3 --seed 1]

prints the port that the plugin opens, and runs until Ctrl-C.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

from . import serving
from .bodies import Body, FreeBody
from .emulated import AWAKE, Counter, EmulatedRoomba, power_of
from .groups import GROUP_BYTES, Contacts, Controls, Sensors
from .motes import Emulator, MotePair
from .protocol import DATA_BYTES, MODE_PAUSE_S, SONGS, WHEELBASE_M, Leds, Mode, Op, StatusLed
from .tinyos import Framing

_BAUD_RATE: Final = 57600
_MOTE_BAUD_RATE: Final = 115200


@dataclass
class Buttons:
    """Which of the buttons are pressed; a test or a simulation sets them."""

    max: bool = False
    clean: bool = False
    spot: bool = False
    power: bool = False


class RoombaEmulator(EmulatedRoomba):
    """A Roomba 4xx; see EmulatedRoomba.

    Attributes:
        lights: the lights as they were set last.
        buttons: the buttons as they are pressed.
        brushes: the cleaning motors: side brush, vacuum, main brush.
    """

    data_bytes = MappingProxyType({op: DATA_BYTES.get(op, 0) for op in Op})
    accepted_in = MappingProxyType(
        {
            Op.START: frozenset(Mode),
            Op.BAUD: AWAKE,
            Op.CONTROL: frozenset({Mode.PASSIVE}),
            Op.SAFE: frozenset({Mode.FULL}),
            Op.FULL: frozenset({Mode.SAFE}),
            Op.SONG: AWAKE,
            Op.SENSORS: AWAKE,
            Op.SEEK_DOCK: frozenset(Mode),
        }
    )
    leads_to = MappingProxyType(
        {
            Op.START: Mode.PASSIVE,
            Op.CONTROL: Mode.SAFE,
            Op.SAFE: Mode.SAFE,
            Op.FULL: Mode.FULL,
            Op.POWER: Mode.PASSIVE,
            Op.SPOT: Mode.PASSIVE,
            Op.CLEAN: Mode.PASSIVE,
            Op.MAX: Mode.PASSIVE,
        }
    )
    usual_baud_rate = _BAUD_RATE
    most_songs = SONGS
    wheelbase_m = WHEELBASE_M

    def __init__(self, body: Body, mode_pause_s: float = MODE_PAUSE_S, *, has_device_detect: bool = False) -> None:
        super().__init__(body, mode_pause_s, has_device_detect=has_device_detect)
        self.lights = Leds()
        self.buttons = Buttons()
        self.brushes = (False, False, False)
        distance_mm, angle_mm = self._travel_mm()
        self._distance, self._angle = Counter(distance_mm), Counter(angle_mm)

    def _execute(self, op: int, data: bytes, now_s: float) -> bytes:  # noqa: ARG002  # as the others have it
        if op == Op.SENSORS:
            return self._sensors(data[0])
        if op == Op.MOTORS:
            self.brushes = (bool(data[0] & 1), bool(data[0] & 2), bool(data[0] & 4))
        elif op == Op.LEDS:
            dirt, max_, clean, spot = (bool(data[0] & 1 << bit) for bit in range(4))
            self.lights = Leds(dirt, max_, clean, spot, StatusLed(data[0] >> 4 & 3), data[1], data[2])
        return b""

    def _rest(self) -> None:
        super()._rest()
        self.brushes = (False, False, False)

    def _sensors(self, group: int) -> bytes:
        if group >= len(GROUP_BYTES):
            self._refuse(f"sensor group {group}")
            return b""
        if group == 1:
            return self._contacts().encode()
        if group == 2:
            return self._controls().encode()
        if group == 3:
            return power_of(self._body).encode()
        return Sensors(self._contacts(), self._controls(), power_of(self._body)).encode()

    def _contacts(self) -> Contacts:
        (bump_left, bump_right), (drop_left, drop_right, caster) = self._body.bumps(), self._body.drops()
        return Contacts(bump_right, bump_left, drop_right, drop_left, caster, self._body.wall(), *self._body.cliffs())

    def _controls(self) -> Controls:
        distance_mm, angle_mm = self._travel_mm()
        pressed = self.buttons
        return Controls(
            button_max=pressed.max,
            button_clean=pressed.clean,
            button_spot=pressed.spot,
            button_power=pressed.power,
            distance_mm=self._distance.take(distance_mm),
            angle_mm=self._angle.take(angle_mm),
        )

    def _travel_mm(self) -> tuple[float, float]:
        """Return distance and angle as the interface counts them, in millimetres in all."""
        left_m, right_m = self._body.travel_m()
        return (left_m + right_m) * 500, (right_m - left_m) * 500


def emulate(settings: Mapping[str, Any], now_s: Callable[[], float]) -> Emulator:
    """Return the emulator for `eal plugin check`: a Roomba on an endless floor, behind motes if its link is one."""
    roomba = RoombaEmulator(FreeBody(now_s, WHEELBASE_M), mode_pause_s=0.0)
    if settings.get("link") != "mote":
        return roomba
    return MotePair(roomba, Framing())


def main(arguments: Sequence[str] | None = None) -> None:
    """Run an emulator until it is interrupted."""
    parser = serving.parser("plugins.mote_roomba.emulator", "A Roomba 4xx on an endless floor.", "its")
    parser.add_argument("--mote", action="store_true", help="behind a pair of motes")
    parser.add_argument("--loss", type=float, default=0.0, help="part of the radio packets that get lost, 0..1")
    parser.add_argument("--radio-tries", type=int, default=1, help="how often a radio packet is sent until it arrives")
    parser.add_argument("--seed", type=int, default=0, help="of what gets lost")
    wanted = parser.parse_args(arguments)

    def make(now: Callable[[], float]) -> tuple[Emulator, FreeBody]:
        body = FreeBody(now, WHEELBASE_M)
        roomba = RoombaEmulator(body, mode_pause_s=0.0)
        if not wanted.mote:
            return roomba, body
        faults = {"loss": wanted.loss, "radio_tries": wanted.radio_tries, "seed": wanted.seed}
        return MotePair(roomba, Framing(), **faults), body

    serving.run(make, (_MOTE_BAUD_RATE if wanted.mote else _BAUD_RATE) if wanted.pace else None)


if __name__ == "__main__":
    main()
