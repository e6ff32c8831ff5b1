"""The emulator of a Roomba 4xx: the Serial Command Interface with any robot body.

It reads no clock and opens no port: its owner passes the bytes and the time. So it works behind a pseudo-terminal, a
socket or a simulated robot.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

from .bodies import RoombaBody
from .emulated_roomba import AWAKE, LEADS_TO, Counter, EmulatedRoomba, power_of
from .groups import GROUP_BYTES, Contacts, Controls, Sensors
from .sci import DATA_BYTES, MODE_PAUSE_S, SONGS, WHEELBASE_M, Mode, Op, SciLights, StatusLed

_BAUD_RATE: Final = 57600


class SciEmulator(EmulatedRoomba):
    """A Roomba 4xx; see EmulatedRoomba.

    Attributes:
        lights: the lights as they were set last.
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
    leads_to = LEADS_TO
    usual_baud_rate = _BAUD_RATE
    most_songs = SONGS
    wheelbase_m = WHEELBASE_M

    def __init__(
        self, body: RoombaBody, mode_pause_s: float = MODE_PAUSE_S, *, has_device_detect: bool = False
    ) -> None:
        super().__init__(body, mode_pause_s, has_device_detect=has_device_detect)
        self.lights = SciLights()
        distance_mm, angle_mm = self._travel_mm()
        self._distance, self._angle = Counter(distance_mm), Counter(angle_mm)

    def _execute(self, op: int, data: bytes, now_s: float) -> bytes:  # noqa: ARG002  # as the others have it
        if op == Op.SENSORS:
            return self._sensors(data[0])
        if op == Op.LEDS:
            dirt, max_, clean, spot = (bool(data[0] & 1 << bit) for bit in range(4))
            self.lights = SciLights(dirt, max_, clean, spot, StatusLed(data[0] >> 4 & 3), data[1], data[2])
        return b""

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
        flags = bump_right, bump_left, drop_right, drop_left, caster, self._body.wall(), *self._body.cliffs()
        strained = self._body.strained()
        return Contacts(*flags, overcurrent_drive_right=strained, overcurrent_drive_left=strained)

    def _controls(self) -> Controls:
        distance_mm, angle_mm = self._travel_mm()
        return Controls(
            **{f"button_{name}": name in self.pressed for name in ("max", "clean", "spot", "power")},
            distance_mm=self._distance.take(distance_mm),
            angle_mm=self._angle.take(angle_mm),
        )

    def _travel_mm(self) -> tuple[float, float]:
        """Return distance and angle as the interface counts them, in millimetres in all."""
        left_m, right_m = self._body.travel_m()
        return (left_m + right_m) * 500, (right_m - left_m) * 500
