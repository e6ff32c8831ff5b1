"""A robot that writes down every beginning, end and halt, to be judged from outside its process."""

# ruff: noqa: N802  # the plugin API names the functions after the resources
from __future__ import annotations

import os
import time
from pathlib import Path

from eal_actors.plugin import (
    Activity,
    DataType,
    EALData,
    EALPlugin,
    PluginContext,
    PluginSettingsModel,
    Resource,
    ResourceType,
    ValueInfo,
    command,
)

_NUMBER = ValueInfo(DataType.INT, minimum=0)
_STEP_S = 0.05
_VIEW = EALData.of(bytes(57_600))


class Settings(PluginSettingsModel):
    """The settings of the fleet file."""

    folder: str
    """Where the robot's notes are kept."""


class Notebook:
    """Appends whole lines to a file, so that a process may be killed at any time."""

    def __init__(self, context: PluginContext) -> None:
        self.clock = context.clock
        path = Path(context.settings.folder) / f"{context.robot}.notes"
        self._file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)

    def note(self, event: str, number: int = 0) -> None:
        """Write a line: the machine's monotonic time, the event, the number of the command."""
        os.write(self._file, f"{time.clock_gettime(time.CLOCK_MONOTONIC):.6f} {event} {number}\n".encode())

    def close(self) -> None:
        """Let go of the file."""
        os.close(self._file)


class Wheels(Resource):
    """Drives for a while, which the number of the command says."""

    types = ResourceType.ACTUATOR

    def __init__(self, notebook: Notebook) -> None:
        self._notebook = notebook

    @command("drive<number>", _NUMBER)
    def drive(self, number: int) -> Activity:
        """Drive for 0.1 to 5.7 s."""
        clock = self._notebook.clock
        end_s = clock.now() + 0.1 + number % 8 * 0.8
        self._notebook.note("begin", number)
        try:
            while (left_s := end_s - clock.now()) > 0:
                yield min(left_s, _STEP_S)
            self._notebook.note("end", number)
        finally:
            self._notebook.note("rest", number)

    def halt(self) -> None:
        self._notebook.note("halt")


class Pen(Resource):
    """Makes a mark at once."""

    types = ResourceType.ACTUATOR

    def __init__(self, notebook: Notebook) -> None:
        self._notebook = notebook

    @command("mark<number>", _NUMBER)
    def mark(self, number: int) -> int:
        """Make a mark."""
        self._notebook.note("mark", number)
        return 1

    def halt(self) -> None:
        """A pen does not move."""


class Gauge(Resource):
    """A sensor with a small view."""

    types = ResourceType.SENSOR

    def get_value(self) -> EALData:
        return _VIEW


class Ward(EALPlugin):
    """The plugin and its notebook."""

    def __init__(self, notebook: Notebook) -> None:
        super().__init__("Wheels", "Pen", "Gauge")
        self.notebook = notebook


def connect(context: PluginContext) -> Ward:
    """Open the notebook."""
    return Ward(Notebook(context))


def disconnect(plugin: Ward) -> None:
    """Close the notebook."""
    plugin.notebook.close()


def create_Wheels(context: PluginContext) -> Wheels:
    return Wheels(context.plugin.notebook)


def create_Pen(context: PluginContext) -> Pen:
    return Pen(context.plugin.notebook)


def create_Gauge() -> Gauge:
    return Gauge()


def destroy_Wheels(resource: Resource) -> None: ...


def destroy_Pen(resource: Resource) -> None: ...


def destroy_Gauge(resource: Resource) -> None: ...
