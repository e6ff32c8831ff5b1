"""The emulator of an EvBot II: the reference firmware with any vehicle.

As a program it emulates a robot on an endless floor:

    python -m plugins.evbot2.emulator --pty [--pace] [--loss 0.1] [--seed 7]

It prints the port for the plugin, runs until Ctrl-C or SIGTERM, and then prints its pose.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from random import Random
from typing import Any, Final

from eal_actors.plugin import BytePort, PacedEmulator, PluginContext, serve_emulator

from .firmware import BaseEmulator, Firmware, any_boot
from .messages import OrderChannel
from .protocol import BAUD_RATE, MODEL, base_codec
from .serving import TICK_S, DeviceTime, FaultyWire, ServedBase
from .vehicle import FreeVehicle, Vehicle
from .wheels import WheelController, WheelModel

TRACKS: Final = WheelModel(track_m=0.24, step_m=0.0005, max_speed_m_s=0.4, acceleration_m_s2=0.5)
"""The tracks of an EvBot II."""


def evbot2(vehicle: Vehicle, tick_s: float, boot: int = 1) -> BaseEmulator:
    """Return an EvBot II, which ticks every `tick_s` while it is busy."""
    wheels = WheelController(vehicle, TRACKS, tick_s)
    return BaseEmulator(Firmware(MODEL, TRACKS, {OrderChannel.WHEELS: wheels}, boot), base_codec())


def simulated_evbot2(vehicle: Any) -> BaseEmulator:
    """Return an EvBot II with the vehicle of a simulated robot."""
    return evbot2(vehicle, vehicle.tick_s)


def free_vehicle(now_s: Callable[[], float], track_factor: float = 1.0) -> FreeVehicle:
    """Return an EvBot II's vehicle on an endless floor."""
    return FreeVehicle(now_s, TRACKS.track_m, TRACKS.acceleration_m_s2, track_factor)


def emulate(settings: Mapping[str, Any], now_s: Callable[[], float]) -> BaseEmulator:  # noqa: ARG001  # the same for all
    """Return the emulator for `eal plugin check`: an EvBot II on an endless floor."""
    return evbot2(free_vehicle(now_s), TICK_S, any_boot())


def emulate_in_world(context: PluginContext, url: str) -> BytePort:
    """Return the emulator for `eal lab`: an EvBot II in a simulated world."""
    return context.simulated_port(url, "evbot2", simulated_evbot2)


def main(arguments: list[str] | None = None) -> None:
    """Run an emulator until it is interrupted."""
    parser = argparse.ArgumentParser(prog="python -m plugins.evbot2.emulator", description="An emulated EvBot II.")
    parser.add_argument("--pty", action="store_true", required=True, help="serve a pseudo-terminal and print its path")
    parser.add_argument("--pace", action="store_true", help=f"delay bytes as a line of {BAUD_RATE} baud does")
    parser.add_argument("--loss", type=share, default=0.0, help="share of the lines that are lost, in each direction")
    parser.add_argument("--seed", type=int, default=0, help="seed of the losses")
    options = parser.parse_args(arguments)
    random = Random(options.seed)  # noqa: S311  # not for security
    there, back = (FaultyWire(random, options.loss) for _ in range(2))

    def make(real_s: Callable[[], float]) -> tuple[PacedEmulator, FreeVehicle]:
        now_s = DeviceTime(real_s)
        vehicle = free_vehicle(now_s)
        served = ServedBase(evbot2(vehicle, TICK_S, any_boot()), now_s, there, back)
        return PacedEmulator(served, BAUD_RATE if options.pace else None), vehicle

    serve_emulator("pty", make, tick_s=TICK_S)


def share(text: str) -> float:
    """Return a share of a command line, 0..1."""
    value = float(text)
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"{text} is no share 0..1")
    return value


if __name__ == "__main__":
    main()
