"""A driver and an emulator at the ends of a wire in memory, on a clock that moves only while something runs."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import Any, ClassVar

from eal_actors.plugin import Activity, BytePort, FleetServices, OdometryNoise, PluginContext, ReopeningPort
from plugins.evbot2 import plugin as evbot2_plugin
from plugins.evbot2.base import Base
from plugins.evbot2.connecting import start_session
from plugins.evbot2.emulator import evbot2, free_vehicle
from plugins.evbot2.firmware import BaseEmulator
from plugins.evbot2.messages import BaseRequest, OrderChannel
from plugins.evbot2.protocol import MODEL, base_codec, host_codec
from plugins.evbot2.serving import FaultyWire
from plugins.evbot2.vehicle import FreeVehicle
from tests.due_activities import DueActivities
from tests.manual_clock import HurriedClock

TICK_S = 0.01
STEP_M = 0.0005  # a count of an encoder


class MemoryPort:
    """A port whose other end is a device; what the driver sends is kept."""

    def __init__(self, device: BaseEmulator, now: Callable[[], float]) -> None:
        self.device = device
        self.now = now
        self.sent = bytearray()
        self.is_cut = False
        """Nothing comes through, either way."""
        self.is_deaf = False
        """The replies do not come through."""
        self.is_broken = False
        """The operating system knows of the loss."""
        self.is_open = True
        self.there: FaultyWire | None = None
        self.back: FaultyWire | None = None
        self._incoming = bytearray()

    def write(self, data: bytes) -> int:
        self._check()
        self.sent += data
        if not self.is_cut:
            for piece in self.there.carry(data) if self.there else [data]:
                self.deliver(piece)
        return len(data)

    def deliver(self, piece: bytes) -> None:
        """Deliver bytes to the device."""
        for reply in self.device.replies(piece, self.now()):
            if not self.is_deaf:
                for arrived in self.back.carry(reply) if self.back else [reply]:
                    self._incoming += arrived

    def arrive(self, data: bytes) -> None:
        """Put bytes on the line that nobody asked for."""
        self._incoming += data

    def read(self, size: int = 1) -> bytes:
        self._check()
        data = bytes(self._incoming[:size])
        del self._incoming[:size]
        return data

    @property
    def in_waiting(self) -> int:
        self._check()
        return len(self._incoming)

    def reset_input_buffer(self) -> None:
        self._incoming.clear()

    def close(self) -> None:
        self.is_open = False

    def _check(self) -> None:
        if self.is_broken:
            raise OSError(5, "Input/output error")


class Rig:
    """An EvBot II, its driver and whatever is between them.

    Args:
        is_there: whether its port can be opened at first.
        settings: of the plugin.
    """

    plugin: Any = evbot2_plugin
    address: ClassVar = {"port": "memory"}

    def __init__(self, *, is_there: bool = True, **settings: Any) -> None:
        self.clock = HurriedClock()
        self.boots = count(41)
        self.body = self.make_body()
        self.device = self.make_device()
        self.is_there = is_there
        self.ports: list[MemoryPort] = []
        checked = self.plugin.Settings.model_validate({**self.address, **settings})
        self.context = PluginContext("rob", "evbot", checked, FleetServices(self.clock))
        self.reopening = ReopeningPort(self._open, self.clock, "memory")
        self.reopening.open()
        self.session, self.odometer = self.make_session()
        self.base: Any = Base(self.session, self.odometer, self.plugin.DRIVETRAIN)
        self._tick_at_s = self.clock.now()
        self._activities = DueActivities(self.clock.now, self._pass, Exception)
        self._activities.begin(self.base.background())

    # What differs between the makes.

    def make_body(self) -> FreeVehicle:
        return free_vehicle(self.clock.now)

    def make_device(self) -> BaseEmulator:
        return evbot2(self.body, TICK_S, next(self.boots))

    def make_session(self) -> Any:
        codec, channels = host_codec(), (OrderChannel.WHEELS,)
        return start_session(
            self.context, self.reopening, codec, model=MODEL, channels=channels, noise=OdometryNoise(0.24)
        )

    # The wire.

    def _open(self) -> BytePort:
        if not self.is_there:
            raise FileNotFoundError(2, "No such file or directory")
        self.ports.append(MemoryPort(self.device, self.clock.now))
        return self.ports[-1]

    @property
    def port(self) -> MemoryPort:
        return self.ports[-1]

    def switch_off_and_on(self) -> None:
        """The base starts anew, and its encoders with it."""
        self.body = self.make_body()
        self.device = self.make_device()
        for port in self.ports:
            port.device = self.device

    def come_back(self) -> None:
        """The port can be opened again; returns when the driver has done so, which takes a real moment."""
        self.is_there = True
        assert self.reopening.wait_until_open(10.0)

    # Time.

    def _pass(self, until_s: float) -> None:
        """Let time pass, with the device at work."""
        while self._tick_at_s <= until_s:
            self.clock.advance(max(0.0, self._tick_at_s - self.clock.now()))
            self.device.tick(self.clock.now())
            self._tick_at_s += TICK_S
        self.clock.advance(max(0.0, until_s - self.clock.now()))

    def wait(self, duration_s: float) -> None:
        """Let time pass, with everything at work."""
        self._activities.wait(duration_s)

    def silence(self, duration_s: float) -> None:
        """Let time pass for the device alone: the driver does nothing at all."""
        end_s = self.clock.now() + duration_s
        self._pass(end_s)
        self._activities.postpone(end_s)

    def start(self, activity: Activity, duration_s: float = 0.0) -> int:
        """Begin an activity, and let time pass."""
        number = self._activities.begin(activity)
        self.wait(duration_s)
        return number

    def close(self, number: int) -> None:
        """Close an activity that was begun, as a halt does."""
        self._activities.close(number)

    def result(self, number: int, most_s: float = 60.0) -> Any:
        """Wait for what an activity returns or raises."""
        end_s = self.clock.now() + most_s
        while number not in self._activities.results:
            assert self._activities.step(end_s), f"it does not end in {most_s} s"
        result = self._activities.results[number]
        if isinstance(result, Exception):
            raise result
        return result

    def run(self, activity: Any) -> Any:
        """Run an activity to its end and return its result; anything else is its own result."""
        return self.result(self._activities.begin(activity)) if hasattr(activity, "send") else activity

    def do(self, *commands: str) -> None:
        for text in commands:
            assert self.run(self.base.send_cmd(text)) == 1

    def stands_for(self, duration_s: float = 1.0) -> bool:
        """Return whether the robot stands for a while, with everything at work."""
        before = self.body.travel_m()
        self.wait(duration_s)
        return self.body.travel_m() == before


def sent_verbs(rig: Rig) -> list[str]:
    """Return the verbs that were sent since the last call."""
    requests = [request for request in base_codec().feed(bytes(rig.port.sent)) if isinstance(request, BaseRequest)]
    rig.port.sent.clear()
    return [request.verb.name for request in requests]
