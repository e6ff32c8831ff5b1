"""A Create 2 without a room, and its driver at the other end of a wire in memory."""

from __future__ import annotations

from typing import Any

from eal_actors.device.world import WorldModel
from eal_actors.plugin import FleetServices, PluginContext
from plugins.roomba import plugin
from plugins.roomba.base import RoombaBase
from plugins.roomba.bodies import FreeRoombaBody
from plugins.roomba.driver import RoombaDriver
from plugins.roomba.link import SerialLink
from plugins.roomba.oi import WHEELBASE_M
from plugins.roomba.oi_driver import STREAMED, OiDriver
from plugins.roomba.oi_emulator import OiEmulator
from plugins.roomba.sci import Mode
from plugins.sim import port as simulated_ports
from plugins.sim.world import world_of
from tests.unit.plugins.roomba.rig import HurriedClock, MemoryPort, Rig

STREAM = bytes([148, len(STREAMED), *STREAMED])


class OiRig(Rig):
    """Driver and emulator on a clock that moves only while something runs."""

    emulator: OiEmulator  # type: ignore[assignment]
    roomba: OiDriver  # type: ignore[assignment]

    def _make(self, mode: Mode, poll_hz: float, *, has_device_detect: bool) -> None:
        self.body = FreeRoombaBody(self.clock.now, WHEELBASE_M)
        self.emulator = OiEmulator(self.body, has_device_detect=has_device_detect)
        self.port = MemoryPort(self.emulator, self.clock.now)
        self.roomba = OiDriver(SerialLink(self.port), self.clock, mode, poll_hz, "rob", WHEELBASE_M)


class SimulatedOiRig(Rig):
    """The whole plugin, at a simulated port: its robot is in a simulated world, alone."""

    roomba: RoombaDriver  # type: ignore[assignment]

    def __init__(self, world: WorldModel, **settings: Any) -> None:
        self.clock = HurriedClock()
        services = FleetServices(self.clock, 0, world, simulated_ports.open_port)
        checked = plugin.Settings.model_validate({"protocol": "oi", "link": "sim", **settings})
        self.roomba = plugin.connect(PluginContext("rob", "roomba", checked, services)).roomba
        self.world = world_of(services)
        self._begin(self.roomba)
        assert isinstance(self.base, RoombaBase)

    @property
    def pose(self) -> tuple[float, float, float]:
        """Where the robot truly is: x in m, y in m, yaw in rad."""
        robot = self.world.robot_of("rob")
        assert robot is not None
        with self.world.caught_up():
            return robot.pose
