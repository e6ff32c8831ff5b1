"""An EvBot III, its driver, and whatever is between them."""

from __future__ import annotations

from typing import Any, ClassVar

from eal_actors.plugin import OdometryNoise
from plugins.evbot2.connecting import start_session
from plugins.evbot2.firmware import BaseEmulator
from plugins.evbot2.messages import OrderChannel
from plugins.evbot3 import plugin as evbot3_plugin
from plugins.evbot3.emulator import FreeTurretVehicle, evbot3
from plugins.evbot3.protocol import MODEL, host_codec
from plugins.evbot3.turret import Turret
from tests.unit.plugins.evbot2.rig import TICK_S, Rig


class Rig3(Rig):
    plugin: Any = evbot3_plugin
    address: ClassVar = {"address": "udp://127.0.0.1:9"}
    body: FreeTurretVehicle

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.turret = Turret(self.session)

    def make_body(self) -> FreeTurretVehicle:
        return FreeTurretVehicle(self.clock.now)

    def make_device(self) -> BaseEmulator:
        return evbot3(self.body, TICK_S, next(self.boots))

    def make_session(self) -> Any:
        channels = (OrderChannel.WHEELS, OrderChannel.TURRET)
        return start_session(
            self.context, self.reopening, host_codec(), model=MODEL, channels=channels, noise=OdometryNoise(0.30)
        )

    def turn(self, *commands: str) -> None:
        for text in commands:
            assert self.run(self.turret.send_cmd(text)) == 1
