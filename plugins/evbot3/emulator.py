"""An EvBot III at the other end of the network: the reference firmware over any body with a turret.

As a program it is a robot on an endless floor:

    python -m plugins.evbot3.emulator --udp 127.0.0.1:0 [--loss 0.1 --duplicate 0.1 --reorder 0.1] [--seed 7]
    python -m plugins.evbot3.emulator --tcp 127.0.0.1:0

prints the address for the fleet file, and runs until Ctrl-C or SIGTERM, when it prints its pose.
"""

from __future__ import annotations

import argparse
import asyncio
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from random import Random
from typing import Any, Final

from eal_actors.plugin import PluginError

from ..evbot2.body import FreeBody, SimulatedBody
from ..evbot2.device import Device
from ..evbot2.emulator import share
from ..evbot2.faults import FaultyWire
from ..evbot2.firmware import Firmware, any_boot
from ..evbot2.messages import Channel
from ..evbot2.serving import TICK_S, Address, Serving, on_tcp, on_udp, run
from ..evbot2.wheels import Actuator, WheelModel, Wheels
from .firmware import Turret, TurretBody, TurretServo, senses
from .protocol import MODEL, BaseCodec

WHEELS: Final = WheelModel(track_m=0.30, step_m=0.0002, max_speed_m_s=0.6, acceleration_m_s2=0.8)
"""The wheels of an EvBot III."""


def evbot3(body: TurretBody, tick_s: float, boot: int = 1) -> Device:
    """Return an EvBot III.

    Args:
        body: what it drives and feels.
        tick_s: how often its `tick` is called while it is busy.
        boot: see Firmware.

    Raises:
        PluginError: the body has no turret.
    """
    if body.turret is None:
        raise PluginError("an EvBot III has a turret, and this body has none")
    actuators: dict[Channel, Actuator] = {
        Channel.WHEELS: Wheels(body, WHEELS, tick_s),
        Channel.TURRET: Turret(body.turret),
    }
    return Device(Firmware(MODEL, WHEELS, actuators, boot, lambda: senses(body)), BaseCodec())


class SimulatedTurretBody(TurretBody, SimulatedBody):
    """A robot of a simulated world with a turret."""


def in_the_world(body: SimulatedTurretBody) -> Device:
    """Return the EvBot III whose body is a robot of a simulated world."""
    return evbot3(body, body.tick_s)


class FreeServo:
    """A turret's motor that turns at an even rate. Args: now_s tells the time."""

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._to_rad = self._rate_rad_s = self._end_s = 0.0

    @property
    def yaw_rad(self) -> float:
        """See TurretServo."""
        return self._to_rad - self._rate_rad_s * self.remaining_s

    @property
    def remaining_s(self) -> float:
        """See TurretServo."""
        return max(0.0, self._end_s - self._now_s())

    def turn(self, angle_rad: float, rate_rad_s: float) -> None:
        """See TurretServo."""
        self._to_rad = self.yaw_rad + angle_rad
        self._rate_rad_s = math.copysign(rate_rad_s, angle_rad)
        self._end_s = self._now_s() + abs(angle_rad) / rate_rad_s

    def stop(self) -> None:
        """See TurretServo."""
        self.turn(0.0, 1.0)


@dataclass(frozen=True, slots=True)
class FullBattery:
    """A battery that is nearly full, and stays so."""

    voltage_v: float = 12.6
    current_a: float = -1.5
    charge_ah: float = 6.5
    capacity_ah: float = 7.2
    temperature_c: float = 23.5


class FreeTurretBody(FreeBody):
    """An EvBot III's body on an endless floor.

    Args:
        now_s: tells the time in seconds.

    Attributes:
        bumped: whether the left and the right bumper are pressed.
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        super().__init__(now_s, WHEELS.track_m, WHEELS.acceleration_m_s2)
        self._turret = FreeServo(now_s)
        self.bumped = (False, False)

    @property
    def turret(self) -> TurretServo | None:
        """See TurretBody."""
        return self._turret

    def bumps(self) -> tuple[bool, bool]:
        """See TurretBody."""
        return self.bumped

    def battery(self) -> FullBattery:
        """See TurretBody."""
        return FullBattery()


def emulate(settings: Mapping[str, Any], now_s: Callable[[], float]) -> Device:  # noqa: ARG001  # the same for all
    """Return the emulator for `eal plugin check`: an EvBot III on an endless floor."""
    return evbot3(FreeTurretBody(now_s), TICK_S, any_boot())


def main(arguments: list[str] | None = None) -> None:
    """Run an emulator until it is interrupted."""
    parser = argparse.ArgumentParser(prog="python -m plugins.evbot3.emulator", description="An emulated EvBot III.")
    way = parser.add_mutually_exclusive_group(required=True)
    way.add_argument("--udp", type=_address, metavar="HOST:PORT", help="take datagrams; port 0 is any free one")
    way.add_argument("--tcp", type=_address, metavar="HOST:PORT", help="take connections; port 0 is any free one")
    for fault, meaning in (("loss", "are lost"), ("duplicate", "arrive twice"), ("reorder", "are overtaken")):
        parser.add_argument(f"--{fault}", type=share, default=0.0, help=f"share of the datagrams that {meaning}")
    parser.add_argument("--seed", type=int, default=0, help="of what befalls them")
    options = parser.parse_args(arguments)
    if options.tcp and (options.loss or options.duplicate or options.reorder):
        parser.error("--loss, --duplicate and --reorder are for --udp: a TCP connection keeps what it carries")
    asyncio.run(_serve(options))


async def _serve(options: argparse.Namespace) -> None:
    random = Random(options.seed)  # noqa: S311  # nobody is to be kept out by it
    body = FreeTurretBody(asyncio.get_running_loop().time)
    there, back = (FaultyWire(random, options.loss, options.duplicate, options.reorder) for _ in range(2))
    serving = Serving(evbot3(body, TICK_S, any_boot()), there, back)
    served, scheme = (on_udp(serving, options.udp), "udp") if options.udp else (on_tcp(serving, options.tcp), "tcp")
    await run(served, body, f"{scheme}://")


def _address(text: str) -> Address:
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise argparse.ArgumentTypeError(f"{text} is no host:port")
    return host, int(port)


if __name__ == "__main__":
    main()
