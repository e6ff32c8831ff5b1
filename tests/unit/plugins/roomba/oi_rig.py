"""A Create 2 without a room, and its driver at the other end of a wire in memory."""

from __future__ import annotations

from plugins.roomba.bodies import FreeRoombaBody
from plugins.roomba.link import SerialLink
from plugins.roomba.oi import WHEELBASE_M
from plugins.roomba.oi_driver import OiDriver
from plugins.roomba.oi_emulator import OiEmulator
from plugins.roomba.sci import Mode
from tests.unit.plugins.roomba.rig import MemoryPort, Rig

STREAM = bytes([148, 8, 1, 18, 3, 35, 41, 42, 43, 44])


class OiRig(Rig):
    """Driver and emulator on a clock that moves only while something runs."""

    emulator: OiEmulator  # type: ignore[assignment]
    roomba: OiDriver  # type: ignore[assignment]

    def _make(self, mode: Mode, poll_hz: float, *, has_device_detect: bool) -> None:
        self.body = FreeRoombaBody(self.clock.now, WHEELBASE_M)
        self.emulator = OiEmulator(self.body, has_device_detect=has_device_detect)
        self.port = MemoryPort(self.emulator, self.clock.now)
        self.roomba = OiDriver(SerialLink(self.port), self.clock, mode, poll_hz, "rob", WHEELBASE_M)
