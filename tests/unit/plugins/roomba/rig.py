"""A Roomba without a room: a body in free space, its emulator, and the driver at the other end of a wire in memory."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

from eal_actors.device.world import WorldModel
from eal_actors.kernel.errors import NotReadyError
from eal_actors.plugin import Activity, FleetServices, PluginContext
from plugins.roomba import plugin
from plugins.roomba.base import RoombaBase
from plugins.roomba.bodies import FreeRoombaBody
from plugins.roomba.driver import RoombaDriver
from plugins.roomba.emulated_roomba import EmulatedRoomba
from plugins.roomba.link import RoombaLink, SerialLink
from plugins.roomba.mote_link import MoteLink
from plugins.roomba.motes import ByteEmulator, MotePair
from plugins.roomba.sci import WHEELBASE_M, Mode
from plugins.roomba.sci_driver import SciDriver
from plugins.roomba.sci_emulator import SciEmulator
from plugins.roomba.tinyos import TinyosFraming
from plugins.sim import port as simulated_ports
from plugins.sim.world import world_of
from tests.manual_clock import HurriedClock, ManualClock

T = TypeVar("T")


@dataclass
class MemoryPort:
    """A serial port whose other end is the emulator; what the driver sends is kept."""

    emulator: ByteEmulator
    now: Callable[[], float]
    sent: bytearray = field(default_factory=bytearray)
    is_cut: bool = False
    is_broken: bool = False
    is_open: bool = True
    name: str = "memory"
    openings: int = 1
    _incoming: bytearray = field(default_factory=bytearray)
    _rts: bool = False

    def write(self, data: bytes) -> int:
        if self.is_broken:
            raise NotReadyError("memory was lost: input/output error")
        self.sent += data
        if not self.is_cut:
            self._incoming += self.emulator.feed(data, self.now())
        return len(data)

    def read(self, size: int = 1) -> bytes:
        if self.is_broken:
            raise NotReadyError("memory was lost: input/output error")
        self._incoming += b"" if self.is_cut else self.emulator.feed(b"", self.now())
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

    def why_not_ready(self) -> str | None:
        return "memory was lost: input/output error" if self.is_broken else None

    def come_back(self) -> None:
        """Be opened again after it was broken."""
        self.is_broken = False
        self.openings += 1
        self._incoming.clear()

    @property
    def rts(self) -> bool:
        return self._rts

    @rts.setter
    def rts(self, on: bool) -> None:
        self._rts = on
        if isinstance(self.emulator, EmulatedRoomba):
            self.emulator.device_detect(low=on, now_s=self.now())

    def use(self, action: Callable[[Any], T]) -> T:
        return action(self)


class Rig:
    """Driver and emulator on a clock that moves only while something runs."""

    def __init__(
        self, mode: Mode = Mode.SAFE, poll_hz: float = 20.0, *, awake: bool = True, has_device_detect: bool = False
    ) -> None:
        self.clock = ManualClock()
        self._make(mode, poll_hz, has_device_detect=has_device_detect)
        self._poll_at_s = math.inf
        if awake:
            self.run(self.roomba.wake())
        self._begin(self.roomba, awake=awake)

    def _make(self, mode: Mode, poll_hz: float, *, has_device_detect: bool) -> None:
        self.body = FreeRoombaBody(self.clock.now, WHEELBASE_M)
        self.emulator = SciEmulator(self.body, has_device_detect=has_device_detect)
        self.port = MemoryPort(self._behind_the_port(), self.clock.now)
        self.roomba = SciDriver(self._link(), self.clock, mode, poll_hz, "rob")

    def _behind_the_port(self) -> ByteEmulator:
        return self.emulator

    def _link(self) -> RoombaLink:
        return SerialLink(self.port)

    def _begin(self, roomba: RoombaDriver, *, awake: bool = True) -> None:
        self.base = RoombaBase(roomba)
        self._polling = self.base.background()
        if awake:
            self.start_background()

    def start_background(self) -> None:
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

    def begin(self, text: str, duration_s: float) -> Activity:
        """Run a command of the base for a while; return its activity, which halts the base when it is collected."""
        activity: Activity = self.base.send_cmd(text)
        self.start(activity, duration_s)
        return activity

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


class MoteRig(Rig):
    """The driver at the base mote, and a Roomba behind the mote on the robot."""

    def __init__(
        self,
        mode: Mode = Mode.SAFE,
        poll_hz: float = 20.0,
        *,
        loss: float = 0.0,
        ack_loss: float = 0.0,
        seed: int = 0,
        radio_tries: int = 1,
        framing: TinyosFraming | None = None,
        awake: bool = True,
    ) -> None:
        self.framing = framing or TinyosFraming()
        self._faults = (loss, ack_loss, radio_tries, seed)
        super().__init__(mode, poll_hz, awake=awake)

    def _behind_the_port(self) -> ByteEmulator:
        loss, ack_loss, tries, seed = self._faults
        self.motes = MotePair(self.emulator, self.framing, loss=loss, ack_loss=ack_loss, radio_tries=tries, seed=seed)
        return self.motes

    def _link(self) -> RoombaLink:
        return MoteLink(self.port, self.clock, self.framing, tries=5)


def without_polls(sent: bytes) -> bytes:
    """Return what was sent besides requests of sensors."""
    for group in range(4):
        sent = sent.replace(bytes([142, group]), b"")
    return sent


class SimulatedRig(Rig):
    """The whole plugin, at a simulated port: its robot is in a simulated world, alone."""

    roomba: RoombaDriver  # type: ignore[assignment]

    def __init__(self, world: WorldModel, protocol: str = "sci", **settings: Any) -> None:
        self.clock = HurriedClock()
        services = FleetServices(self.clock, 0, world, simulated_ports.open_port)
        checked = plugin.Settings.model_validate({"protocol": protocol, "link": "sim", **settings})
        self.roomba = plugin.connect(PluginContext("rob", "roomba", checked, services)).roomba
        self.world = world_of(services)
        self._begin(self.roomba)

    @property
    def pose(self) -> tuple[float, float, float]:
        """Where the robot truly is: x in m, y in m, yaw in rad."""
        robot = self.world.robot_of("rob")
        assert robot is not None
        with self.world.lock:
            self.world.catch_up()
            return robot.pose
