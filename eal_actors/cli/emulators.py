"""Emulators of the devices that a fleet file leaves open.

Which module of a plugin emulates its device, and with which arguments, is declared as `emulator` in its manifest. Each
emulator runs in a process of its own, on an endless floor. If the fleet has a world, one process, `lab_world`, has the
emulators of all devices that can be in it.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import eal_actors
from eal_actors.cli import emulator_main
from eal_actors.cli.readiness import kill, ready_line
from eal_actors.kernel.errors import UnsupportedError
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.manifest import EmulatorSection, PluginManifest, discover

_PREFIX: Final = "LAB_"
_MARK: Final = f"<{_PREFIX}"
_STOP_S: Final = 5.0  # real seconds until an emulator that does not end is killed
_POSE: Final = re.compile(r"^pose (\S+) m (\S+) m (\S+) deg$", re.MULTILINE)

_ROOT: Final = str(Path(eal_actors.__file__).parents[1])

LabPose = tuple[float, float, float]
"""x in m, y in m, yaw in degrees, in (-180, 180]."""


@dataclass(frozen=True, slots=True)
class LabDevice:
    """A device of a robot that a fleet file takes from unset variables.

    Attributes:
        variables: the unset variables, by the settings that take their values from them.
        settings: all settings of the plugin, or of its part.
        part: the part of the plugin to which it belongs, such as `ceiling` for `cameras.ceiling`; empty if none.
    """

    robot: str
    plugin: PluginManifest
    variables: Mapping[str, str]
    settings: Mapping[str, Any]
    part: str = ""
    is_in_world: bool = False

    @property
    def section(self) -> EmulatorSection:
        """The declaration of the emulator."""
        return self.plugin.file.emulator or EmulatorSection()

    def command(self) -> list[str]:
        """Return the command that runs the plugin's emulator, which may be no program, but only answer bytes."""
        section = self.section
        packages = [f"{plugin.name}={plugin.folder.resolve()}" for plugin in (self.plugin, *self.plugin.used())]
        program = [sys.executable, "-P", str(emulator_main.__file__), self.plugin.name, section.module, *packages]
        if section.arguments is not None:
            return [*program, "--", *section.program_arguments(self.settings)]
        given = {key: value for key, value in self.settings.items() if key not in self.variables}
        return [*program, "--wire", section.wire or "", json.dumps(given, default=str)]

    def addresses(self, line: str) -> dict[str, str]:
        """Return the values of the variables, from the emulator's first line: a setting's value, or an address."""
        section = self.section
        values = section.driver_settings(line) if self.is_in_world or section.arguments is None else {}
        return {variable: str(values.get(setting, line)) for setting, variable in self.variables.items()}


class _MarkedEnvironment(Mapping[str, str]):
    """The environment, with a mark as the value of each unset LAB_ variable."""

    def __getitem__(self, name: str) -> str:
        return os.environ[name] if name in os.environ or not name.startswith(_PREFIX) else f"<{name}>"

    def __iter__(self) -> Iterator[str]:
        return iter(os.environ)

    def __len__(self) -> int:
        return len(os.environ)


def open_devices(fleet: Path) -> list[LabDevice]:
    """Return the devices of a fleet that can be emulated: settings `${LAB_...:-...}` of plugins with an emulator.

    Raises ConfigError with the problems of the file.
    """
    return devices_of(load_marked(fleet))


def load_marked(fleet: Path) -> FleetConfig:
    """Return the configuration of a fleet whose open settings are marked; ConfigError with the problems of the file."""
    return EALConfigManager.load(fleet, environment=_MarkedEnvironment()).fleet


def devices_of(config: FleetConfig) -> list[LabDevice]:
    """Return the devices of a marked fleet that can be emulated."""
    manifests, _ = discover(config.plugin_dirs)
    found = []
    for robot in config.robots.values():
        for plugin in robot.plugins.values():
            manifest = manifests.get(plugin.plugin)
            section = manifest.file.emulator if manifest is not None else None
            if manifest is None or section is None:
                continue
            in_world = config.world is not None and section.world_wire is not None
            if in_world or section.arguments is not None or section.wire is not None:
                for part, settings, variables in _marked_parts("", plugin.tree.root):
                    found.append(LabDevice(robot.name, manifest, variables, settings, part, in_world))
    return found


def _marked_parts(part: str, settings: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any], Mapping[str, str]]]:
    """Yield the parts of a plugin's settings that have marks, and the variables by their keys."""
    marks = {key: value[1:-1] for key, value in settings.items() if str(value).startswith(_MARK)}
    if marks:
        yield part, settings, marks
    for key, value in settings.items():
        if isinstance(value, Mapping):
            yield from _marked_parts(key, value)


class EmulatorProcesses:
    """Runs emulators for the length of a `with` block, in which the variables name them.

    Each runs in a session of its own, so that Ctrl-C in a terminal reaches the controller only, and the emulators
    receive its last stop. They end with this process, however it ends.

    Attributes:
        addresses: the value of each variable.
        starts: by robot, its pose in the world at the beginning; without a world it is (0, 0, 0).
        poses: by robot, its pose at the end of the block.
        failures: by robot, why its emulator had ended before the end of the block.
    """

    def __init__(self, devices: Sequence[LabDevice], fleet: Path = Path()) -> None:
        self.addresses: dict[str, str] = {}
        self.starts: dict[str, LabPose] = {}
        self.poses: dict[str, LabPose] = {}
        self.failures: dict[str, str] = {}
        self._devices = devices
        self._fleet = fleet
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        """Start the emulators, and wait until all of them listen.

        Raises:
            UnavailableError: one has ended, and the reason is on stderr; or it is not ready in time.
            UnsupportedError: their plugins need packages that are not installed.
        """
        if lacks := dict.fromkeys(filter(None, (device.plugin.lacks() for device in self._devices))):
            raise UnsupportedError("; ".join(lacks))
        with ExitStack() as stack:
            alone = [device for device in self._devices if not device.is_in_world]
            running = [(device, stack.enter_context(self._run(device))) for device in alone]
            if in_world := [device for device in self._devices if device.is_in_world]:
                world = stack.enter_context(self._run_world(in_world))
                begin = json.loads(ready_line(world, "emulator", in_world[0].robot))
                self.addresses |= begin["addresses"]
                self.starts = {robot: tuple(pose) for robot, pose in begin["poses"].items()}
            for device, process in running:
                self.addresses |= device.addresses(ready_line(process, "emulator", device.robot))
            os.environ.update(self.addresses)
            for variable in self.addresses:
                stack.callback(os.environ.pop, variable, None)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_exc_info: object) -> None:
        self._stack.close()

    @contextmanager
    def _run(self, device: LabDevice) -> Iterator[subprocess.Popen[str]]:
        process = _start(device.command())
        try:
            yield process
        finally:
            if (how := _early_end(process)) is not None:
                self.failures[device.robot] = f"the emulator of {device.plugin.name} {how}"
            if (pose := _POSE.search(_end(process))) is not None:
                x_m, y_m, yaw_deg = map(float, pose.groups())
                self.poses[device.robot] = x_m, y_m, yaw_deg

    @contextmanager
    def _run_world(self, devices: Sequence[LabDevice]) -> Iterator[subprocess.Popen[str]]:
        process = _start([sys.executable, "-P", "-m", "eal_actors.cli.lab_world", str(self._fleet)])
        try:
            yield process
        finally:
            if (how := _early_end(process)) is not None:
                self.failures |= {device.robot: f"the world of the emulators {how}" for device in devices}
            if line := _end(process):
                self.poses |= {robot: tuple(pose) for robot, pose in json.loads(line).items()}


def _start(command: Sequence[str]) -> subprocess.Popen[str]:
    return subprocess.Popen(  # noqa: S603  # a plugin's own program, or ours
        command,
        stdin=subprocess.PIPE,  # the emulator ends when this closes
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (_ROOT, os.environ.get("PYTHONPATH"))))},
        start_new_session=True,
    )


def _early_end(process: subprocess.Popen[str]) -> str | None:
    """Return how an emulator has ended; None if it still runs."""
    if (code := process.poll()) is None:
        return None
    return f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"


def _end(process: subprocess.Popen[str]) -> str:
    """Close the emulator's stdin, and return the rest of its output."""
    try:
        return process.communicate(timeout=_STOP_S)[0]
    except subprocess.TimeoutExpired:
        kill(process)
        return process.communicate()[0]
