"""The emulator of every kind of Roomba, for `eal plugin check`, and as a program.

    python -m plugins.roomba.emulator --protocol oi --pty [--pace]
    python -m plugins.roomba.emulator --protocol sci --pty [--pace] [--mote [--loss 0.3 --radio-tries 5 --seed 1]]

The program has an endless floor. It prints the port that the plugin opens, and runs until Ctrl-C or SIGTERM. Then it
prints its pose.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from eal_actors.plugin import BytePort, PacedEmulator, PluginContext, serve_emulator

from . import oi, sci
from .bodies import FreeRoombaBody, OtherWheelbase, RoombaBody
from .emulated_roomba import EmulatedRoomba
from .motes import ByteEmulator, MotePair
from .oi_emulator import OiEmulator
from .sci_emulator import SciEmulator
from .tinyos import Header, TinyosFraming

_WHEELBASE_M: Final = {"sci": sci.WHEELBASE_M, "oi": oi.WHEELBASE_M}
SIMULATED_WHEELBASE_M: Final = sci.WHEELBASE_M
"""The simulated Roomba is a 4xx, with either protocol."""
_BAUD_RATE: Final = {"sci": sci.BAUD_RATE, "oi": oi.BAUD_RATE}
_MOTE_BAUD_RATE: Final = 115200
_TICK_S: Final = 0.001
"""Interval of paced bytes, and of output that nobody asked for."""
_NOT_OF_PACKETS: Final = ("baudrate", "tries")


def make_emulator(protocol: str, body: RoombaBody, wheelbase_m: float) -> EmulatedRoomba:
    """Return the emulator of a Roomba by its protocol, `sci` or `oi`, which ignores the pauses after changes of mode.

    The bytes come through an operating system, or in ticks of a simulation that may be longer than the pauses.
    """
    if protocol == "sci":
        return SciEmulator(body, mode_pause_s=0.0)
    return OiEmulator(body, mode_pause_s=0.0, wheelbase_m=wheelbase_m)


def emulate(settings: Mapping[str, Any], now_s: Callable[[], float]) -> ByteEmulator | None:
    """Return the emulator for `eal plugin check`: a Roomba on an endless floor, behind motes if its link is `mote`."""
    if settings.get("link") == "sim":
        return None
    roomba, _ = _free_roomba(settings["protocol"], now_s)
    return _at_its_link(settings, roomba)


def emulate_in_world(context: PluginContext, url: str) -> BytePort:
    """Return the emulator for `eal lab`: a Roomba in a simulated world, behind motes if its link is `mote`."""
    settings = context.settings
    protocol = settings["protocol"]

    def make(body: RoombaBody) -> ByteEmulator:
        wheelbase_m = _WHEELBASE_M[protocol]
        as_wide = OtherWheelbase(body, wheelbase_m / SIMULATED_WHEELBASE_M)
        return _at_its_link(settings, make_emulator(protocol, as_wide, wheelbase_m))

    return context.simulated_port(url, "roomba", make)


def _at_its_link(settings: Mapping[str, Any], roomba: EmulatedRoomba) -> ByteEmulator:
    if settings.get("link") != "mote":
        return roomba
    packets = {key: value for key, value in settings.get("mote", {}).items() if key not in _NOT_OF_PACKETS}
    return MotePair(roomba, TinyosFraming(**{**packets, "header": Header(packets.get("header", Header.TINYOS_2))}))


def _free_roomba(protocol: str, now_s: Callable[[], float]) -> tuple[EmulatedRoomba, FreeRoombaBody]:
    body = FreeRoombaBody(now_s, _WHEELBASE_M[protocol])
    return make_emulator(protocol, body, _WHEELBASE_M[protocol]), body


def main(arguments: Sequence[str] | None = None) -> None:
    """Run an emulator until it is interrupted."""
    parser = argparse.ArgumentParser(
        prog="python -m plugins.roomba.emulator", description="A Roomba on an endless floor."
    )
    parser.add_argument("--pty", action="store_true", required=True, help="serve a pseudo-terminal, and print its path")
    parser.add_argument("--pace", action="store_true", help="delay bytes by the baud rate of the line")
    parser.add_argument("--protocol", choices=sorted(_BAUD_RATE), required=True, help="oi: a Create 2; sci: a 4xx")
    parser.add_argument("--mote", action="store_true", help="behind a pair of motes")
    parser.add_argument("--loss", type=float, default=0.0, help="share of the radio packets that are lost, 0..1")
    parser.add_argument("--radio-tries", type=int, default=1, help="how often a radio packet is sent until it arrives")
    parser.add_argument("--seed", type=int, default=0, help="of the losses")
    wanted = parser.parse_args(arguments)

    def make(now_s: Callable[[], float]) -> tuple[PacedEmulator, FreeRoombaBody]:
        served: ByteEmulator
        served, body = _free_roomba(wanted.protocol, now_s)
        baud_rate = _BAUD_RATE[wanted.protocol]
        if wanted.mote:
            faults = {"loss": wanted.loss, "radio_tries": wanted.radio_tries, "seed": wanted.seed}
            served, baud_rate = MotePair(served, TinyosFraming(), **faults), _MOTE_BAUD_RATE
        return PacedEmulator(served, baud_rate if wanted.pace else None), body

    serve_emulator("pty", make, tick_s=_TICK_S)


if __name__ == "__main__":
    main()
