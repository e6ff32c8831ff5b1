"""A Roomba without a room: a body in free space, its emulator, and the driver at the other end of a wire in memory."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from eal_actors.clock import ManualClock
from eal_actors.plugin import Activity, FleetServices, PluginContext, WorldModel
from plugins.mote_roomba import plugin
from plugins.mote_roomba.base import Base
from plugins.mote_roomba.emulator import RoombaEmulator
from plugins.mote_roomba.link import SerialLink
from plugins.mote_roomba.protocol import Mode
from plugins.mote_roomba.roomba import Roomba
from plugins.sim import port as simulated_ports
from plugins.sim.world import world_of


@dataclass
class Battery:
    voltage_v: float = 16.1
    current_a: float = -0.3
    charge_ah: float = 1.35
    capacity_ah: float = 2.7
    temperature_c: float = 24.0


class Wheel:
    """A wheel that takes time to reach its speed."""

    def __init__(self) -> None:
        self.target_m_s = self.speed_m_s = self.travel_m = 0.0

    def turn(self, duration_s: float, acceleration_m_s2: float) -> None:
        lack_m_s = self.target_m_s - self.speed_m_s
        ramp_s = min(duration_s, abs(lack_m_s) / acceleration_m_s2)
        before_m_s = self.speed_m_s
        self.speed_m_s += math.copysign(ramp_s * acceleration_m_s2, lack_m_s)
        if ramp_s < duration_s:
            self.speed_m_s = self.target_m_s
        self.travel_m += (before_m_s + self.speed_m_s) / 2 * ramp_s + self.speed_m_s * (duration_s - ramp_s)


class FreeBody:
    """A body in free space, which feels what a test says."""

    def __init__(self, now: Callable[[], float], acceleration_m_s2: float = 0.8) -> None:
        self._now = now
        self._acceleration_m_s2 = acceleration_m_s2
        self._at_s = now()
        self.left, self.right = Wheel(), Wheel()
        self.bumped = (False, False)
        self.dropped = (False, False, False)
        self.over_cliffs = (False, False, False, False)
        self.by_wall = False
        self.stuck = False
        self.charge = Battery()

    def _catch_up(self) -> None:
        now_s = self._now()
        if not self.stuck:
            for wheel in (self.left, self.right):
                wheel.turn(now_s - self._at_s, self._acceleration_m_s2)
        self._at_s = now_s

    def drive(self, left_m_s: float, right_m_s: float) -> None:
        self._catch_up()
        self.left.target_m_s, self.right.target_m_s = left_m_s, right_m_s

    def travel_m(self) -> tuple[float, float]:
        self._catch_up()
        return self.left.travel_m, self.right.travel_m

    def bumps(self) -> tuple[bool, bool]:
        return self.bumped

    def drops(self) -> tuple[bool, bool, bool]:
        return self.dropped

    def cliffs(self) -> tuple[bool, bool, bool, bool]:
        return self.over_cliffs

    def wall(self) -> bool:
        return self.by_wall

    def battery(self) -> Battery:
        return self.charge


@dataclass
class MemoryPort:
    """A serial port whose other end is the emulator; what the driver sends is kept."""

    emulator: RoombaEmulator
    now: Callable[[], float]
    sent: bytearray = field(default_factory=bytearray)
    is_cut: bool = False
    is_broken: bool = False
    is_open: bool = True
    _incoming: bytearray = field(default_factory=bytearray)

    def write(self, data: bytes) -> int:
        if self.is_broken:
            raise OSError(5, "Input/output error")
        self.sent += data
        if not self.is_cut:
            self._incoming += self.emulator.feed(data, self.now())
        return len(data)

    def read(self, size: int = 1) -> bytes:
        if self.is_broken:
            raise OSError(5, "Input/output error")
        data = bytes(self._incoming[:size])
        del self._incoming[:size]
        return data

    @property
    def in_waiting(self) -> int:
        return len(self._incoming)

    def arrive(self, data: bytes) -> None:
        """Put bytes on the line that nobody asked for."""
        self._incoming += data

    def reset_input_buffer(self) -> None:
        self._incoming.clear()

    def close(self) -> None:
        self.is_open = False


class HurriedClock(ManualClock):
    """A clock on which who sleeps moves the time."""

    def sleep(self, duration_s: float) -> None:
        self.advance(duration_s)


class Rig:
    """Driver and emulator on a clock that moves only while something runs."""

    def __init__(self, mode: Mode = Mode.SAFE, poll_hz: float = 20.0, *, awake: bool = True) -> None:
        self.clock = ManualClock()
        self.body = FreeBody(self.clock.now)
        self.emulator = RoombaEmulator(self.body)
        self.port = MemoryPort(self.emulator, self.clock.now)
        self.roomba = Roomba(SerialLink(self.port, "memory"), self.clock, mode, poll_hz, "rob")
        self._poll_at_s = math.inf
        if awake:
            self.run(self.roomba.wake())
        self._begin(self.roomba, awake=awake)

    def _begin(self, roomba: Roomba, *, awake: bool = True) -> None:
        self.base = Base(roomba)
        self._polling = self.base.background()
        if awake:
            self._poll_at_s = self.clock.now()
            self.wait(0.01)

    def _step(self, until_s: float) -> bool:
        """Do what the background has to do next, if that is due by then; returns whether it was."""
        if self._poll_at_s > until_s:
            return False
        self._move_to(self._poll_at_s)
        self._poll_at_s = self.clock.now() + next(self._polling)
        return True

    def _move_to(self, time_s: float) -> None:
        self.clock.advance(max(0.0, time_s - self.clock.now()))

    def wait(self, duration_s: float) -> None:
        """Let time pass, with the background at work."""
        end_s = self.clock.now() + duration_s
        while self._step(end_s):
            pass
        self._move_to(end_s)

    def start(self, activity: Activity, duration_s: float) -> None:
        """Run an activity for a while; it must not end by then."""
        end_s = next_s = self.clock.now()
        end_s += duration_s
        while next_s <= end_s:
            if not self._step(next_s):
                self._move_to(next_s)
                next_s = self.clock.now() + next(activity)
        self.wait(end_s - self.clock.now())

    def run(self, activity: Any) -> Any:
        """Run an activity to its end, with the background at work, and return its result."""
        next_s = self.clock.now()
        for _ in range(1_000_000):
            if self._step(next_s):
                continue
            self._move_to(next_s)
            try:
                next_s = self.clock.now() + next(activity)
            except StopIteration as end:
                return end.value
        raise AssertionError(f"{activity} does not end")

    def do(self, *commands: str) -> None:
        for text in commands:
            result = self.base.send_cmd(text)
            assert result == 1 or self.run(result) == 1

    def take_sent(self) -> bytes:
        sent = bytes(self.port.sent)
        self.port.sent.clear()
        return sent


def without_polls(sent: bytes) -> bytes:
    """Return what was sent besides Sensors 0."""
    return sent.replace(bytes([142, 0]), b"")


class SimulatedRig(Rig):
    """The whole plugin, at a simulated port: its robot is in a simulated world, alone."""

    def __init__(self, world: WorldModel, **settings: Any) -> None:
        self.clock = HurriedClock()
        services = FleetServices(self.clock, 0, world, simulated_ports.open_port)
        checked = plugin.Settings.model_validate({"port": "sim://world", **settings})
        self.roomba = plugin.connect(PluginContext("rob", "mote_roomba", checked, services)).roomba
        self.world = world_of(services)
        self._begin(self.roomba)

    @property
    def pose(self) -> tuple[float, float, float]:
        """Where the robot truly is: x in m, y in m, yaw in rad."""
        robot = self.world.robot_of("rob")
        assert robot is not None
        with self.world.caught_up():
            return robot.pose
