"""Simulated serial ports: a driver's emulator at the other end, connected to a robot of the world.

A driver with `port: sim://world/roomba-1` uses its own wire protocol with its own emulator, which drives and senses the
robot of that name. Nothing blocks: the bytes of an answer are there when the write returns.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final
from urllib.parse import urlsplit

from eal_actors.plugin import PluginContext, PluginError, UnavailableError

from .arena import Pose2D
from .models import MAKES
from .parts import SimBattery, SimTurret
from .robot import SimRobot
from .sensors import dropped_wheels, is_wall_near, pressed_bumpers, seen_cliffs
from .world import SimWorld, world_of

_BUFFER_SIZE: Final = 65536
"""Bytes that may wait to be read; further bytes are lost, as in any serial buffer."""


class SimVehicle:
    """The interface of an emulator to a robot of the world. Thread: holds the world's `lock`."""

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        self._world = world
        self._robot = robot

    @property
    def tick_s(self) -> float:
        """Length of a physics tick."""
        return self._world.tick_s

    @property
    def pose(self) -> Pose2D:
        """The true pose: x and y in m and yaw in rad; for a sensor that depends on the place."""
        return self._robot.pose

    @property
    def turret(self) -> SimTurret | None:
        """The turret, if the make has one."""
        return self._robot.turret

    def drive(self, left_m_s: float, right_m_s: float) -> None:
        """Set the wheels' speeds until the next call; both 0 stops."""
        if left_m_s == right_m_s == 0.0:
            self._world.stop(self._robot)
            return
        with suppress(UnavailableError):  # as on a real robot, an empty battery reports no error on the wire
            self._world.drive(self._robot, left_m_s, right_m_s)

    def travel_m(self) -> tuple[float, float]:
        """Return the totals of the left and the right encoder, forward positive."""
        return self._robot.travel_m

    def strained(self) -> bool:
        """Return whether something blocks the motors."""
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

    def battery(self) -> SimBattery:
        """Return the battery."""
        return self._robot.battery


class SimulatedPort:
    """A port with the five members of pyserial's that drivers use. Thread: any; does not block.

    Args:
        emulate: creates the emulator of a vehicle. The emulator has `feed(data, now_s) -> reply`. If it also has
            `is_busy` and `tick(now_s)`, it is ticked at every physics tick while it is busy.
    """

    def __init__(self, world: SimWorld, robot: SimRobot, emulate: Callable[[Any], Any]) -> None:
        self._world = world
        self._robot = robot
        self._received = bytearray()
        self._is_open = True
        with world.lock:
            world.catch_up()
            self._emulator = emulate(SimVehicle(world, robot))
            self._is_ticked = hasattr(self._emulator, "is_busy")

    @property
    def in_waiting(self) -> int:
        """The number of bytes that can be read."""
        with self._world.lock:
            self._world.catch_up()
            self._check_open()
            return len(self._received)

    def write(self, data: bytes) -> int:
        """Send bytes to the device; return their number."""
        with self._world.lock:
            now_s = self._world.catch_up()
            self._check_open()
            self._feed(bytes(data), now_s)
        return len(data)

    def feed(self, data: bytes, now_s: float) -> bytes:  # noqa: ARG002  # the world's time is later, and the right one
        """Send bytes to the device, and return all received bytes, as an emulator does."""
        self.write(data)
        return self.read(_BUFFER_SIZE)

    @property
    def pose(self) -> Pose2D:
        """The true pose of the robot."""
        with self._world.lock:
            self._world.catch_up()
            return self._robot.pose

    def read(self, size: int = 1) -> bytes:
        """Return at most `size` received bytes; empty for none."""
        with self._world.lock:
            now_s = self._world.catch_up()
            self._check_open()
            self._feed(b"", now_s)
            taken = bytes(self._received[:size])
            del self._received[:size]
        return taken

    def reset_input_buffer(self) -> None:
        """Discard the received bytes."""
        with self._world.lock:
            self._world.catch_up()
            self._received.clear()

    def close(self) -> None:
        """Close the port; the robot stays as it is, as a real one does."""
        self._is_open = False

    def _feed(self, data: bytes, now_s: float) -> None:
        if not self._has_power:  # a device without power does not answer
            return
        self._received += self._emulator.feed(data, now_s)
        del self._received[_BUFFER_SIZE:]
        if self._is_ticked and self._emulator.is_busy:
            self._world.add_tick_callback(self._tick)

    def _tick(self, now_s: float) -> bool:
        """Tick the emulator; return whether it needs another tick."""
        if not (self._is_ticked and self._has_power):
            return False
        self._emulator.tick(now_s)
        return bool(self._emulator.is_busy)

    @property
    def _has_power(self) -> bool:
        return not (self._robot.is_dead or self._robot.battery.is_empty)

    def _check_open(self) -> None:
        if not self._is_open:
            raise OSError("the port is closed")


def open_port(context: PluginContext, url: str, model: str | None, emulate: Callable[[Any], Any]) -> SimulatedPort:
    """Return the port of a URL `sim://world/<robot>`; a robot of a known make joins the world if it is new.

    Without a path the robot is the driver's own. A model of None stands for a robot of any make that is in the world.
    `emulate` creates the emulator of a vehicle; see `SimulatedPort`.

    Raises:
        PluginError: the URL is invalid, or the robot is of another make or not there.
    """
    parts = urlsplit(url)
    name = parts.path.strip("/") or context.robot
    if parts.netloc != "world" or "/" in name or parts.query or parts.fragment:
        raise PluginError(f"port {url!r}: a simulated port has the form sim://world/<robot>")
    world = world_of(context.services)
    robot = world.robot_of(name)
    if model is None:
        if robot is None:
            raise PluginError(
                f"port {url!r}: no robot {name!r} is in the simulated world yet; its plugin `sim` must come first"
            )
        return SimulatedPort(world, robot, emulate)
    make = next((make for make in MAKES.values() if make.name == model), None)
    if make is None:
        raise PluginError(f"port {url!r}: the simulation has no make {model!r}; use {', '.join(MAKES)}")
    robot = robot or world.join(name, make, noise=True, start=None)
    if robot.make.name != model:
        raise PluginError(f"port {url!r}: robot {name!r} of the simulated world is a {robot.make.name}, not a {model}")
    return SimulatedPort(world, robot, emulate)
