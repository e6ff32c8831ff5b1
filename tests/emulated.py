"""Emulated robots at real wires, whose faults a test chooses, and whose wheels bear witness."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from random import Random
from typing import Any, Generic, Protocol, TypeVar

from eal_actors.device.emulator_wires import TICK_S, WIRES
from eal_actors.kernel.clock import REAL_TIME
from plugins.evbot2.emulator import evbot2, free_vehicle
from plugins.evbot2.firmware import any_boot
from plugins.evbot2.serving import FaultyWire, ServedBase
from plugins.evbot3.emulator import FreeTurretVehicle, evbot3
from plugins.roomba.bodies import FreeRoombaBody
from plugins.roomba.motes import MotePair
from plugins.roomba.sci import WHEELBASE_M
from plugins.roomba.sci_emulator import SciEmulator
from plugins.roomba.tinyos import TinyosFraming

WAIT_S = 30.0
"""Real seconds after which a test that waits for something gives up."""


class Body(Protocol):
    """Returns the position of an emulated robot."""

    @property
    def pose(self) -> tuple[float, float, float]: ...

    def travel_m(self) -> tuple[float, float]: ...


class Emulator(Protocol):
    """Bytes in, bytes out."""

    def feed(self, data: bytes, now_s: float) -> bytes: ...


B = TypeVar("B", bound=Body)


class Emulated(Generic[B]):
    """An emulated robot at the end of a wire that a test can pull out, cut and freeze.

    Args:
        kind: of its wire: `pty`, `tcp` or `udp`.
        make: makes the emulator and its body from what tells the body's time.
        rate: seconds of their time in one real second.
    """

    def __init__(self, kind: str, make: Callable[[Callable[[], float]], tuple[Emulator, B]], rate: float = 1.0) -> None:
        self.struck = threading.Event()
        """Whether the planned incident has happened."""
        self._lock = threading.RLock()
        self._rate = rate
        self._later_s = self._body_later_s = 0.0
        self._emulator, self.body = make(lambda: self._now_s() + self._body_later_s)
        self._thawed = threading.Event()
        self._thawed.set()
        self._is_cut = False
        self._strike: tuple[float, Callable[[], object]] | None = None
        self.wire = WIRES[kind](lambda: self)
        self.wire.plug_in()

    @property
    def address(self) -> str:
        return self.wire.address

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Feed the emulator unless it is frozen. Thread: the wire's."""
        self._thawed.wait(WAIT_S)
        with self._lock:
            if self._is_cut:
                return b""
            reply = self._emulator.feed(data, self._now_s())
            if self._strike is not None and reply and self.travelled_m >= self._strike[0]:
                (_, strike), self._strike = self._strike, None
                strike()
                self.struck.set()
                return reply[: len(reply) // 2] if self._says_no_more() else reply
            return reply

    @property
    def travelled_m(self) -> float:
        return max(map(abs, self.body.travel_m()))

    # What befalls it.

    def strike_after(self, metres: float, strike: Callable[[], object]) -> None:
        """Have something happen, in the thread of the wire, as soon as a wheel has travelled so much more."""
        with self._lock:
            self.struck.clear()
            self._strike = (self.travelled_m + metres, strike)

    def cut(self) -> None:
        """End in the middle of what is being said; nothing comes through any more."""
        self._is_cut = True

    def _says_no_more(self) -> bool:
        return self._is_cut

    def freeze(self) -> None:
        """Hear and say nothing until `thaw`."""
        self._thawed.clear()

    def thaw(self) -> None:
        self._thawed.set()

    def unplug(self) -> None:
        self.wire.unplug()

    def plug_in(self) -> None:
        """Bring it back as it is: it was not switched off."""
        self._is_cut = False
        self.wire.plug_in()

    def close(self) -> None:
        self.thaw()
        self.wire.close()

    # What it witnesses.

    def let_pass(self, duration_s: float) -> None:
        """Let time pass in which it hears nothing."""
        with self._lock:
            for _ in range(round(duration_s / TICK_S)):
                self._later_s += TICK_S
                self._emulator.feed(b"", self._now_s())

    def stands(self) -> bool:
        """Return whether it comes to rest, and stays there for a minute, if nothing is said to it."""
        self.wire.drain()
        with self._lock:
            self._body_later_s += 5.0
            pose = self.body.pose
            self._body_later_s += 60.0
            return self.body.pose == pose

    def _now_s(self) -> float:
        return REAL_TIME.now() * self._rate + self._later_s


@contextmanager
def plugged_in(robot: Emulated[B]) -> Iterator[Emulated[B]]:
    """Remove a robot, and its wire, at the end of a `with` block."""
    try:
        yield robot
    finally:
        robot.close()


def an_evbot2() -> Emulated[Any]:
    def make(now_s: Callable[[], float]) -> tuple[Emulator, Any]:
        body = free_vehicle(now_s)
        return evbot2(body, TICK_S, any_boot()), body

    return Emulated("pty", make)


def an_evbot3(loss: float = 0.0, seed: int = 0, rate: float = 1.0) -> Emulated[FreeTurretVehicle]:
    def make(now_s: Callable[[], float]) -> tuple[Emulator, FreeTurretVehicle]:
        body, random = FreeTurretVehicle(now_s), Random(seed)  # noqa: S311
        there, back = FaultyWire(random, loss), FaultyWire(random, loss)
        return ServedBase(evbot3(body, TICK_S, any_boot()), now_s, there, back), body

    return Emulated("udp", make, rate)


def a_roomba(loss: float = 0.0, radio_tries: int = 1, seed: int = 0, rate: float = 1.0) -> Emulated[FreeRoombaBody]:
    """Return a Roomba behind a pair of motes."""

    def make(now_s: Callable[[], float]) -> tuple[Emulator, FreeRoombaBody]:
        body = FreeRoombaBody(now_s, WHEELBASE_M)
        roomba = SciEmulator(body, mode_pause_s=0.0)
        return MotePair(roomba, TinyosFraming(), loss=loss, radio_tries=radio_tries, seed=seed), body

    return Emulated("pty", make, rate)


PATIENT = {"poll_hz": 5, "watchdog_s": 2}
"""For robots on a machine that stumbles."""


def plugin_of(make: str, address: str) -> dict[str, Any]:
    """Return what a fleet file says of an emulated robot."""
    settings: dict[str, dict[str, Any]] = {
        "evbot2": {"evbot2": {"port": address, **PATIENT}},
        "evbot3": {"evbot3": {"address": f"udp://{address}", **PATIENT}},
        "roomba": {"roomba": {"protocol": "sci", "port": address, "link": "mote", "mote": {"tries": 20}}},
    }
    return settings[make]
