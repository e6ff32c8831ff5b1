"""An EvBot III, its driver, and whatever is between them."""

from __future__ import annotations

from typing import Any, ClassVar

from plugins.evbot2.connecting import come_up
from plugins.evbot2.device import Device
from plugins.evbot2.messages import Channel
from plugins.evbot3 import plugin as evbot3_plugin
from plugins.evbot3.emulator import FreeTurretBody, evbot3
from plugins.evbot3.protocol import MODEL, HostCodec
from plugins.evbot3.turret import Turret
from tests.unit.plugins.evbot2.rig import TICK_S, Rig


class Rig3(Rig):
    plugin: Any = evbot3_plugin
    address: ClassVar = {"address": "udp://127.0.0.1:9"}
    body: FreeTurretBody

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.turret = Turret(self.talk)

    def make_body(self) -> FreeTurretBody:
        return FreeTurretBody(self.clock.now)

    def make_device(self) -> Device:
        return evbot3(self.body, TICK_S, next(self.boots))

    def make_talk(self) -> Any:
        channels = (Channel.WHEELS, Channel.TURRET)
        return come_up(self.context, self.reopening, HostCodec(), model=MODEL, channels=channels, track_m=0.30)

    def turn(self, *commands: str) -> None:
        for text in commands:
            assert self.run(self.turret.send_cmd(text)) == 1
