"""A plugin whose actuator logs each begin, end and halt to a file that other processes can read."""

# ruff: noqa: N802  # the plugin API names the functions after the resources
from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from eal_actors import plugin as api

FRAME_SHAPE = (480, 640, 3)
_STEP_S = 0.02
_SECONDS = api.ValueInfo(api.DataType.DOUBLE, "s", minimum=0)


class Settings(api.PluginSettingsModel):
    """The settings of the fleet file."""

    file: str
    """File of the notes."""


class Notebook:
    """Appends whole lines to a file, so that a process may be killed at any time."""

    def __init__(self, context: api.PluginContext) -> None:
        self.robot = context.robot
        self.clock = context.clock
        self._file = os.open(context.settings.file, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)

    def note(self, event: str, what: str = "-") -> None:
        """Write a line: the machine's monotonic time, the robot, the event, what it is about."""
        now_s = time.clock_gettime(time.CLOCK_MONOTONIC)
        os.write(self._file, f"{now_s:.6f} {self.robot} {event} {what}\n".encode())


class Arm(api.Resource):
    """An actuator whose commands last as long as their argument says."""

    types = api.ResourceType.ACTUATOR
    value = api.ValueInfo(api.DataType.DOUBLE, minimum=-1, maximum=1)

    def __init__(self, notebook: Notebook) -> None:
        self._notebook = notebook
        self._moving = 0
        self._value = 0.0
        self._speed = 0.5

    def get_status(self) -> int:
        return self._moving

    def get_value(self) -> float:
        return self._value

    def set_value(self, data: api.EALData) -> None:
        self._value = float(data.value)
        self._notebook.note("set", f"{self._value:g}")

    @contextmanager
    def _move(self, what: str) -> Iterator[None]:
        self._notebook.note("begin", what)
        self._moving = 1
        try:
            yield
            self._notebook.note("end", what)
        finally:
            self._moving = 0

    @api.command("move<seconds>", _SECONDS)
    def move(self, seconds: float) -> api.Activity:
        """Move for so long; the answer is 7."""
        with self._move(f"move{seconds:g}"):
            end_s = self._notebook.clock.now() + seconds
            while (left_s := end_s - self._notebook.clock.now()) > 0:
                self.progress(1 - left_s / seconds, f"{left_s:.1f} s left")
                yield min(left_s, _STEP_S)
        return 7

    @api.command("step<number>", api.ValueInfo(api.DataType.INT))
    def step(self, number: int) -> int:
        """Note a number at once, and answer it."""
        self._notebook.note("step", str(number))
        return number

    @api.command("to<number>", api.ValueInfo(api.DataType.INT), repeatable=True)
    def to(self, number: int) -> api.Activity:
        """Move to a place, from wherever it is."""
        with self._move(f"to{number}"):
            yield _STEP_S
        return 1

    @api.command("put", api.ValueInfo(api.DataType.INT))
    def put(self, number: int) -> None:
        """Take a number that is no part of the text."""
        self._notebook.note("put", str(number))

    @api.command("mumble<seconds>", _SECONDS)
    def mumble(self, seconds: float) -> api.Activity:
        """Move for so long, and report what is no text."""
        with self._move(f"mumble{seconds:g}"):
            self.progress(0.5, OSError("\udcff"))  # type: ignore[arg-type]
            yield seconds
        return 1

    @api.command("jam")
    def jam(self) -> api.Activity:
        """Begin, and fail."""
        yield 0.0
        raise OSError("jammed")

    @api.command("crash")
    def crash(self) -> None:
        """End the resource's actor."""
        raise SystemExit(1)

    @api.command("s", urgent=True)
    def stop(self) -> None:
        """Stop."""
        self._notebook.note("stop")

    @api.config("speed", api.ValueInfo(api.DataType.DOUBLE, "m/s", minimum=0, maximum=1))
    def speed(self) -> float:
        """How fast."""
        return self._speed

    @api.config_setter("speed")
    def set_speed(self, speed: float) -> None:
        self._speed = speed

    @api.config("serial", api.ValueInfo(api.DataType.CHAR))
    def serial(self) -> str:
        """Which one it is."""
        return "W-1"

    def halt(self) -> None:
        self._notebook.note("halt")


class Gauge(api.Resource):
    """A sensor with requests that take time or fail."""

    types = api.ResourceType.SENSOR
    value = api.ValueInfo(api.DataType.INT)

    def __init__(self, notebook: Notebook) -> None:
        self._notebook = notebook

    def get_status(self) -> int:
        return 3

    def get_value(self) -> int:
        return -42

    @api.request("slow<seconds>", api.ValueInfo(api.DataType.DOUBLE), _SECONDS)
    def slow(self, seconds: float) -> float:
        """Hold up everything for so long."""
        self._notebook.note("slow", f"{seconds:g}")
        self._notebook.clock.sleep(seconds)
        return seconds

    @api.request("fault")
    def fault(self) -> int:
        """Raise."""
        raise ZeroDivisionError("no gauge")

    @api.request("refuse")
    def refuse(self) -> int:
        """Refuse."""
        raise api.ArgumentError("not today")

    @api.request("text", api.ValueInfo(api.DataType.INT))
    def text(self) -> str:
        """Answer something else than promised."""
        return "text"


class Eye(api.Resource):
    """A sensor of large values, which takes large values too."""

    types = api.ResourceType.SENSOR

    def __init__(self, notebook: Notebook) -> None:
        self._clock = notebook.clock
        self._frame = (np.arange(np.prod(FRAME_SHAPE)) % 251).astype(np.uint8).reshape(FRAME_SHAPE)

    def get_value(self) -> api.EALData:
        return api.EALData.of(self._frame)

    def set_value(self, data: api.EALData) -> int:
        return data.length

    @api.request("slow<seconds>", api.ValueInfo(api.DataType.DOUBLE), _SECONDS)
    def slow(self, seconds: float) -> float:
        """Hold up everything for so long."""
        self._clock.sleep(seconds)
        return seconds

    @api.request("blob<bytes>", None, api.ValueInfo(api.DataType.INT, minimum=0))
    def blob(self, count: int) -> api.EALData:
        """Answer so many bytes."""
        return api.EALData.of(np.zeros(count, np.uint8))


class Line(api.Resource):
    """A line that gives back what was written to it; a request is written too, `wait0.3` after 0.3 s."""

    types = api.ResourceType.COMMUNICATION

    def __init__(self, notebook: Notebook) -> None:
        self._notebook = notebook
        self._bytes = b""

    def read_comm(self, length: int) -> bytes:
        taken, self._bytes = self._bytes[:length], self._bytes[length:]
        return taken

    def write_comm(self, data: api.EALData, length: int) -> int:
        self._bytes += bytes(data.payload)[:length]
        return length

    def send_req(self, req: str) -> str:
        if req.startswith("wait"):
            self._notebook.note("asked", req)
            self._notebook.clock.sleep(float(req.removeprefix("wait")))
        self._bytes += req.encode()
        return req

    def halt(self) -> None: ...


class Watch(api.Resource):
    """Returns the machine's monotonic time, stamped by the robot's own clock."""

    types = api.ResourceType.SENSOR | api.ResourceType.COMMUNICATION

    def __init__(self, notebook: Notebook) -> None:
        self._clock = notebook.clock
        self._age_s = -1.0

    def get_value(self) -> api.EALData:
        return api.EALData.of(time.clock_gettime(time.CLOCK_MONOTONIC), stamp_s=self._clock.now())

    def read_comm(self, length: int) -> api.Activity:
        """Take longer than a query waits."""
        yield 0.5
        return api.EALData.of(time.clock_gettime(time.CLOCK_MONOTONIC), stamp_s=self._clock.now())

    def set_value(self, data: api.EALData) -> None:
        assert data.stamp_s is not None
        self._age_s = self._clock.now() - data.stamp_s

    @api.request("age", api.ValueInfo(api.DataType.DOUBLE, "s"))
    def age(self) -> float:
        """How old the value was that was set last."""
        return self._age_s

    def halt(self) -> None: ...


class Witness(api.EALPlugin):
    """Keeps the notebook of its resources."""

    def __init__(self, notebook: Notebook) -> None:
        super().__init__("Arm", "Gauge", "Eye", "Line", "Watch")
        self.notebook = notebook


def connect(context: api.PluginContext) -> Witness:
    return Witness(Notebook(context))


def disconnect(plugin: Witness) -> None: ...


def create_Arm(context: api.PluginContext) -> Arm:
    return Arm(context.plugin.notebook)


def destroy_Arm(resource: Arm) -> None: ...


def create_Gauge(context: api.PluginContext) -> Gauge:
    return Gauge(context.plugin.notebook)


def destroy_Gauge(resource: Gauge) -> None: ...


def create_Eye(context: api.PluginContext) -> Eye:
    return Eye(context.plugin.notebook)


def destroy_Eye(resource: Eye) -> None: ...


def create_Line(context: api.PluginContext) -> Line:
    return Line(context.plugin.notebook)


def destroy_Line(resource: Line) -> None: ...


def create_Watch(context: api.PluginContext) -> Watch:
    return Watch(context.plugin.notebook)


def destroy_Watch(resource: Watch) -> None: ...
