"""An EvBot II at the other end of the wire: the reference firmware over any body that drives.

As a program it is a robot on an endless floor:

    python -m plugins.evbot2.emulator --pty [--pace] [--loss 0.1] [--seed 7]

prints the port that the plugin opens, and runs until Ctrl-C or SIGTERM, when it prints its pose.
"""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Callable, Mapping
from random import Random
from typing import Any, Final

from .body import Body, FreeBody, SimulatedBody
from .device import Device
from .faults import FaultyWire
from .firmware import Firmware, any_boot
from .messages import Channel
from .protocol import BAUD_RATE, MODEL, BaseCodec
from .serving import TICK_S, Serving, on_pty, run
from .wheels import WheelModel, Wheels

TRACKS: Final = WheelModel(track_m=0.24, step_m=0.0005, max_speed_m_s=0.4, acceleration_m_s2=0.5)
"""The tracks of an EvBot II."""


def evbot2(body: Body, tick_s: float, boot: int = 1) -> Device:
    """Return an EvBot II.

    Args:
        body: what it drives.
        tick_s: how often its `tick` is called while it is busy.
        boot: see Firmware.
    """
    return Device(Firmware(MODEL, TRACKS, {Channel.WHEELS: Wheels(body, TRACKS, tick_s)}, boot), BaseCodec())


def in_the_world(body: SimulatedBody) -> Device:
    """Return the EvBot II whose body is a robot of a simulated world."""
    return evbot2(body, body.tick_s)


def free_body(now_s: Callable[[], float], track_factor: float = 1.0) -> FreeBody:
    """Return an EvBot II's body on an endless floor."""
    return FreeBody(now_s, TRACKS.track_m, TRACKS.acceleration_m_s2, track_factor)


def emulate(settings: Mapping[str, Any], now_s: Callable[[], float]) -> Device:  # noqa: ARG001  # the same for all
    """Return the emulator for `eal plugin check`: an EvBot II on an endless floor."""
    return evbot2(free_body(now_s), TICK_S, any_boot())


def main(arguments: list[str] | None = None) -> None:
    """Run an emulator until it is interrupted."""
    parser = argparse.ArgumentParser(prog="python -m plugins.evbot2.emulator", description="An emulated EvBot II.")
    parser.add_argument("--pty", action="store_true", required=True, help="serve a pseudo-terminal; prints its path")
    parser.add_argument("--pace", action="store_true", help=f"send as slowly as {BAUD_RATE} baud")
    parser.add_argument("--loss", type=share, default=0.0, help="share of the lines that are lost, each way")
    parser.add_argument("--seed", type=int, default=0, help="of what is lost")
    asyncio.run(_serve(parser.parse_args(arguments)))


async def _serve(options: argparse.Namespace) -> None:
    random = Random(options.seed)  # noqa: S311  # nobody is to be kept out by it
    body = free_body(asyncio.get_running_loop().time)
    there, back = (FaultyWire(random, options.loss) for _ in range(2))
    serving = Serving(evbot2(body, TICK_S, any_boot()), there, back, BAUD_RATE if options.pace else None)
    await run(on_pty(serving), body)


def share(text: str) -> float:
    """Return a share of a command line, 0..1."""
    value = float(text)
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"{text} is no share 0..1")
    return value


if __name__ == "__main__":
    main()
