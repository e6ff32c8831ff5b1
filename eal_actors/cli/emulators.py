"""Emulators of the devices that a fleet file leaves open, each in a process of its own.

Which module of a plugin emulates its device, and with which arguments, is declared as `emulator` in its manifest.
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
from types import TracebackType
from typing import Any, Final, Self

import eal_actors
from eal_actors.cli import emulator_main
from eal_actors.kernel.errors import UnavailableError
from eal_actors.managers.config import EALConfigManager
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
        robot: the robot's name.
        plugin: the manifest of the plugin that drives it.
        variables: the unset variables, by the settings that take their values from them.
        settings: all settings of the plugin.
    """

    robot: str
    plugin: PluginManifest
    variables: Mapping[str, str]
    settings: Mapping[str, Any]

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
        values = section.driver_settings(line) if section.arguments is None else {}
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

    Raises:
        ConfigError: the problems of the file.
    """
    config = EALConfigManager.load(fleet, environment=_MarkedEnvironment()).fleet
    manifests, _ = discover(config.plugin_dirs)
    found = []
    for robot in config.robots.values():
        for plugin in robot.plugins.values():
            manifest = manifests.get(plugin.plugin)
            section = manifest.file.emulator if manifest is not None else None
            if manifest is None or section is None or (section.arguments is None and section.wire is None):
                continue
            settings = plugin.tree.root
            variables = {key: mark[1:-1] for key, value in settings.items() if (mark := str(value)).startswith(_MARK)}
            if variables:
                found.append(LabDevice(robot.name, manifest, variables, settings))
    return found


class EmulatorProcesses:
    """Runs emulators for the length of a `with` block, in which the variables name them.

    Each runs in a session of its own, so that Ctrl-C in a terminal reaches the controller only, and the emulators
    receive its last stop. They end with this process, however it ends.

    Attributes:
        addresses: the value of each variable.
        poses: by robot, its pose at the end of the block, from (0, 0, 0) at the beginning.
        failures: by robot, why its emulator had ended before the end of the block.
    """

    def __init__(self, devices: Sequence[LabDevice]) -> None:
        self.addresses: dict[str, str] = {}
        self.poses: dict[str, LabPose] = {}
        self.failures: dict[str, str] = {}
        self._devices = devices
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        """Start the emulators, and wait until all of them listen.

        Raises:
            UnavailableError: one has ended; the reason is on stderr.
        """
        with ExitStack() as stack:
            running = [(device, stack.enter_context(self._run(device))) for device in self._devices]
            for device, process in running:
                self.addresses |= device.addresses(_read_address(device, process))
            os.environ.update(self.addresses)
            for variable in self.addresses:
                stack.callback(os.environ.pop, variable, None)
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._stack.close()

    @contextmanager
    def _run(self, device: LabDevice) -> Iterator[subprocess.Popen[str]]:
        process = subprocess.Popen(  # noqa: S603  # the plugin's own program
            device.command(),
            stdin=subprocess.PIPE,  # the emulator ends when this closes
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (_ROOT, os.environ.get("PYTHONPATH"))))},
            start_new_session=True,
        )
        try:
            yield process
        finally:
            if (code := process.poll()) is not None:
                how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
                self.failures[device.robot] = f"the emulator of {device.plugin.name} {how}"
            if (pose := _POSE.search(_end(process))) is not None:
                x_m, y_m, yaw_deg = map(float, pose.groups())
                self.poses[device.robot] = x_m, y_m, yaw_deg


def _read_address(device: LabDevice, process: subprocess.Popen[str]) -> str:
    line = process.stdout.readline().strip() if process.stdout is not None else ""
    if not line:
        raise UnavailableError("its emulator has ended; see above", robot=device.robot)
    return line


def _end(process: subprocess.Popen[str]) -> str:
    """Close the emulator's stdin, and return the rest of its output."""
    try:
        return process.communicate(timeout=_STOP_S)[0]
    except subprocess.TimeoutExpired:
        process.kill()
        return process.communicate()[0]
