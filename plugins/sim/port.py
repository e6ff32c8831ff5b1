"""Simulated serial ports: a driver's emulator at the far end, and a robot of the world as its body.

A driver that is told `port: sim://world/roomba-1` speaks its own wire protocol to its own emulator, which drives and
feels the robot of that name. Nothing waits: the bytes of an answer are there when the write returns.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final, Protocol, runtime_checkable
from urllib.parse import urlsplit

from eal_actors.plugin import PluginContext, PluginError, UnavailableError

from .battery import Battery
from .models import MAKES
from .robot import SimRobot
from .sensors import dropped_wheels, is_wall_near, pressed_bumpers, seen_cliffs
from .turret import Turret
from .world import SimWorld, world_of

_MOST_WAITING: Final = 65536
"""Bytes that may wait to be read; what comes on top is lost, as in any serial buffer."""


class Emulator(Protocol):
    """A device at the far end of a wire."""

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Take bytes from the wire and return the reply to them."""
        ...


@runtime_checkable
class BusyEmulator(Emulator, Protocol):
    """A device that has things to do by itself, such as to end a motion, also while no byte comes."""

    @property
    def is_busy(self) -> bool:
        """Whether it has."""
        ...

    def tick(self, now_s: float) -> None:
        """Do what is due; called once a physics tick while it is busy."""
        ...


class SimBody:
    """A robot of the world, as an emulator drives and feels it. Thread: inside the world's `caught_up`."""

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        self._world = world
        self._robot = robot

    @property
    def tick_s(self) -> float:
        """Length of a physics tick."""
        return self._world.tick_s

    @property
    def turret(self) -> Turret | None:
        """The turret, if the make has one."""
        return self._robot.turret

    def drive(self, left_m_s: float, right_m_s: float) -> None:
        """Set the wheels' speeds until the next call; both 0 stops."""
        if left_m_s == right_m_s == 0.0:
            self._world.stop(self._robot)
            return
        with suppress(UnavailableError):  # an empty battery turns no wheel, and says nothing of it
            self._world.drive(self._robot, left_m_s, right_m_s)

    def travel_m(self) -> tuple[float, float]:
        """Return what the left and the right wheel's encoder have counted in all, forward positive."""
        return self._robot.travel_m

    def strained(self) -> bool:
        """Return whether the motors strain against something that holds the robot up."""
        return self._robot.is_blocked

    def bumps(self) -> tuple[bool, bool]:
        """Return whether the left and the right bumper are pressed."""
        return pressed_bumpers(self._robot)

    def drops(self) -> tuple[bool, bool, bool]:
        """Return whether the left wheel, the right wheel and the caster have dropped."""
        return dropped_wheels(self._world, self._robot)

    def cliffs(self) -> tuple[bool, bool, bool, bool]:
        """Return whether there is no floor under left, front left, front right and right."""
        return seen_cliffs(self._world, self._robot)

    def wall(self) -> bool:
        """Return whether there is something close to the right-hand side."""
        return is_wall_near(self._robot)

    def battery(self) -> Battery:
        """Return the battery."""
        return self._robot.battery


class SimulatedPort:
    """A port as pyserial's, with the five members that drivers use. Thread: any; nothing blocks.

    Args:
        world: the world that the robot is in.
        robot: the robot behind the emulator.
        emulate: makes the emulator for a body.
    """

    def __init__(self, world: SimWorld, robot: SimRobot, emulate: Callable[[Any], Emulator]) -> None:
        self._world = world
        self._robot = robot
        self._arrived = bytearray()
        self._is_open = True
        with world.caught_up():
            self._emulator = emulate(SimBody(world, robot))
            self._busy = self._emulator if isinstance(self._emulator, BusyEmulator) else None

    @property
    def in_waiting(self) -> int:
        """How many bytes can be read."""
        with self._world.caught_up():
            self._check_open()
            return len(self._arrived)

    def write(self, data: bytes) -> int:
        """Send bytes to the device; return how many."""
        with self._world.caught_up() as now_s:
            self._check_open()
            self._feed(bytes(data), now_s)
        return len(data)

    def read(self, size: int = 1) -> bytes:
        """Return what has arrived, at most so many bytes; empty for nothing."""
        with self._world.caught_up() as now_s:
            self._check_open()
            self._feed(b"", now_s)
            taken = bytes(self._arrived[:size])
            del self._arrived[:size]
        return taken

    def reset_input_buffer(self) -> None:
        """Forget what has arrived."""
        with self._world.caught_up():
            self._arrived.clear()

    def close(self) -> None:
        """Let go of the port; the robot stays as it is, as a real one does."""
        self._is_open = False

    def _feed(self, data: bytes, now_s: float) -> None:
        if not self._has_power:  # nobody answers
            return
        self._arrived += self._emulator.feed(data, now_s)
        del self._arrived[_MOST_WAITING:]
        if self._busy is not None and self._busy.is_busy:
            self._world.attend(self._tick)

    def _tick(self, now_s: float) -> bool:
        """Let the emulator do what is due; return whether it wants another tick."""
        if self._busy is None or not self._has_power:
            return False
        self._busy.tick(now_s)
        return self._busy.is_busy

    @property
    def _has_power(self) -> bool:
        return not (self._robot.is_dead or self._robot.battery.is_empty)

    def _check_open(self) -> None:
        if not self._is_open:
            raise OSError("the port is closed")


def open_port(context: PluginContext, url: str, model: str, emulate: Callable[[Any], Emulator]) -> SimulatedPort:
    """Return the port of a URL `sim://world/<robot>`; the robot joins the world if it is not there.

    Args:
        context: of the driver.
        url: names the robot in the world; without a path it is the driver's own.
        model: the robot's make.
        emulate: makes the emulator for a body.

    Raises:
        PluginError: the URL names nothing that can be, or the robot is of another make.
    """
    parts = urlsplit(url)
    name = parts.path.strip("/") or context.robot
    if parts.netloc != "world" or "/" in name or parts.query or parts.fragment:
        raise PluginError(f"port {url!r}: a simulated port is called sim://world/<robot>")
    make = next((make for make in MAKES.values() if make.name == model), None)
    if make is None:
        raise PluginError(f"port {url!r}: no robot of the simulation is a {model!r}; there are {', '.join(MAKES)}")
    world = world_of(context.services)
    robot = world.robot_of(name) or world.join(name, make, noise=True, start=None)
    if robot.make.name != model:
        raise PluginError(f"port {url!r}: robot {name!r} of the simulated world is a {robot.make.name}, not a {model}")
    return SimulatedPort(world, robot, emulate)
