"""The emulator of an EvBot III: the reference firmware with any vehicle that has a turret.

As a program it emulates a robot on an endless floor:

    python -m plugins.evbot3.emulator --udp 127.0.0.1:0 [--loss 0.1 --duplicate 0.1 --reorder 0.1] [--seed 7]
    python -m plugins.evbot3.emulator --tcp 127.0.0.1:0

It prints the address for the fleet file, runs until Ctrl-C or SIGTERM, and then prints its pose.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping
from random import Random
from typing import Any, Final

from typing_extensions import override

from eal_actors.plugin import BytePort, PluginContext, PluginError, serve_emulator

from ..evbot2.emulator import share
from ..evbot2.firmware import BaseEmulator, Firmware, any_boot
from ..evbot2.messages import OrderChannel
from ..evbot2.serving import TICK_S, DeviceTime, FaultyWire, ServedBase
from ..evbot2.vehicle import FreeVehicle
from ..evbot2.wheels import Actuator, WheelController, WheelModel
from ..roomba.bodies import ConstantBattery
from .firmware import TurretController, TurretServo, TurretVehicle, senses
from .protocol import MODEL, base_codec

WHEELS: Final = WheelModel(track_m=0.30, step_m=0.0002, max_speed_m_s=0.6, acceleration_m_s2=0.8)
"""The wheels of an EvBot III."""

_BATTERY: Final = ConstantBattery(12.6, -1.5, 6.5, 7.2, 23.5)


def evbot3(vehicle: TurretVehicle, tick_s: float, boot: int = 1) -> BaseEmulator:
    """Return an EvBot III, which ticks every `tick_s` while it is busy.

    Raises:
        PluginError: the vehicle has no turret.
    """
    if vehicle.turret is None:
        raise PluginError("an EvBot III needs a vehicle with a turret")
    actuators: dict[OrderChannel, Actuator] = {
        OrderChannel.WHEELS: WheelController(vehicle, WHEELS, tick_s),
        OrderChannel.TURRET: TurretController(vehicle.turret),
    }
    return BaseEmulator(Firmware(MODEL, WHEELS, actuators, boot, lambda: senses(vehicle)), base_codec())


def simulated_evbot3(vehicle: Any) -> BaseEmulator:
    """Return an EvBot III with the vehicle of a simulated robot."""
    return evbot3(vehicle, vehicle.tick_s)


class FreeServo(TurretServo):
    """A turret servo with a constant rate. Args: now_s returns the time."""

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._to_rad = self._rate_rad_s = self._end_s = 0.0

    @property
    @override
    def yaw_rad(self) -> float:
        return self._to_rad - self._rate_rad_s * self.remaining_s

    @property
    @override
    def remaining_s(self) -> float:
        return max(0.0, self._end_s - self._now_s())

    @override
    def turn(self, angle_rad: float, rate_rad_s: float) -> None:
        self._to_rad = self.yaw_rad + angle_rad
        self._rate_rad_s = math.copysign(rate_rad_s, angle_rad)
        self._end_s = self._now_s() + abs(angle_rad) / rate_rad_s

    @override
    def stop(self) -> None:
        self.turn(0.0, 1.0)


class FreeTurretVehicle(FreeVehicle, TurretVehicle):
    """An EvBot III's vehicle on an endless floor.

    Args:
        now_s: returns the time in seconds.

    Attributes:
        bumped: whether the left and the right bumper are pressed.
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        super().__init__(now_s, WHEELS.track_m, WHEELS.acceleration_m_s2)
        self._turret = FreeServo(now_s)
        self.bumped = (False, False)

    @property
    @override
    def turret(self) -> TurretServo | None:
        return self._turret

    @override
    def bumps(self) -> tuple[bool, bool]:
        return self.bumped

    @override
    def battery(self) -> ConstantBattery:
        return _BATTERY


def emulate(settings: Mapping[str, Any], now_s: Callable[[], float]) -> BaseEmulator:  # noqa: ARG001  # the same for all
    """Return the emulator for `eal plugin check`: an EvBot III on an endless floor."""
    return evbot3(FreeTurretVehicle(now_s), TICK_S, any_boot())


def emulate_in_world(context: PluginContext, url: str) -> BytePort:
    """Return the emulator for `eal lab`: an EvBot III in a simulated world."""
    return context.simulated_port(url, "evbot3", simulated_evbot3)


def main(arguments: list[str] | None = None) -> None:
    """Run an emulator until it is interrupted."""
    parser = argparse.ArgumentParser(prog="python -m plugins.evbot3.emulator", description="An emulated EvBot III.")
    transport = parser.add_mutually_exclusive_group(required=True)
    transport.add_argument("--udp", type=_address, metavar="HOST:PORT", help="listen for datagrams; port 0: any port")
    transport.add_argument("--tcp", type=_address, metavar="HOST:PORT", help="listen for connections; port 0: any port")
    for fault, meaning in (("loss", "are lost"), ("duplicate", "arrive twice"), ("reorder", "are overtaken")):
        parser.add_argument(f"--{fault}", type=share, default=0.0, help=f"share of the datagrams that {meaning}")
    parser.add_argument("--seed", type=int, default=0, help="seed of the faults")
    options = parser.parse_args(arguments)
    if options.tcp and (options.loss or options.duplicate or options.reorder):
        parser.error("--loss, --duplicate and --reorder need --udp: a TCP connection does not lose data")
    random = Random(options.seed)  # noqa: S311  # not for security
    there, back = (FaultyWire(random, options.loss, options.duplicate, options.reorder) for _ in range(2))

    def make(real_s: Callable[[], float]) -> tuple[ServedBase, FreeTurretVehicle]:
        now_s = DeviceTime(real_s)
        vehicle = FreeTurretVehicle(now_s)
        return ServedBase(evbot3(vehicle, TICK_S, any_boot()), now_s, there, back), vehicle

    wire = "udp" if options.udp else "tcp"
    serve_emulator(wire, make, at=options.udp or options.tcp, scheme=f"{wire}://", tick_s=TICK_S)


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise argparse.ArgumentTypeError(f"{text} is not host:port")
    return host, int(port)


if __name__ == "__main__":
    main()
