"""Emulators for the wires that a fleet file leaves open, each a program of its own."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import eal_actors.cli.leash
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.errors import UnavailableError
from eal_actors.managers.config import EALConfigManager

_PREFIX: Final = "LAB_"
_STOP_S: Final = 5.0
"""Real seconds that an emulator has to end by itself."""
_POSE: Final = re.compile(r"^pose (\S+) m (\S+) m (\S+) deg$", re.MULTILINE)

Pose = tuple[float, float, float]
"""x in m, y in m, yaw in degrees, in (-180, 180]."""


@dataclass(frozen=True, slots=True)
class Wire:
    """A setting of a robot that a fleet file takes from a variable that is not set.

    Attributes:
        robot: the robot's name.
        plugin: the plugin whose setting it is.
        variable: the variable's name.
        settings: all of the plugin's settings.
    """

    robot: str
    plugin: str
    variable: str
    settings: Mapping[str, Any]


class _Marked(Mapping[str, str]):
    """The environment, in which each variable of an emulator that is not set is a mark."""

    def __getitem__(self, name: str) -> str:
        return os.environ[name] if name in os.environ or not name.startswith(_PREFIX) else f"<{name}>"

    def __iter__(self) -> Iterator[str]:
        return iter(os.environ)

    def __len__(self) -> int:
        return len(os.environ)


def open_wires(fleet: Path) -> list[Wire]:
    """Return the wires of a fleet that an emulator can be put behind: settings that are `${LAB_...:-...}`.

    Raises:
        ConfigError: everything that is wrong with the file.
    """
    found = []
    for robot in EALConfigManager.load(fleet, environment=_Marked()).fleet.robots.values():
        for plugin in robot.plugins.values():
            settings = plugin.tree.root
            marks = [str(value) for value in settings.values() if str(value).startswith(f"<{_PREFIX}")]
            found += [Wire(robot.name, plugin.plugin, mark[1:-1], settings) for mark in marks]
    return [wire for wire in found if wire.plugin in _ARGUMENTS]


def _with_motes(settings: Mapping[str, Any]) -> Sequence[str]:
    return ("--pty", "--pace", "--mote") if settings.get("link") == "mote" else ("--pty", "--pace")


_ARGUMENTS: Final[Mapping[str, Callable[[Mapping[str, Any]], Sequence[str]]]] = {
    "camera": lambda _: ("--folder",),
    "evbot2": lambda _: ("--pty", "--pace"),
    "evbot3": lambda _: ("--udp", "127.0.0.1:0"),
    "mote_roomba": _with_motes,
    "roomba_oi": lambda _: ("--pty", "--pace"),
}
"""What the program `plugins.<plugin>.emulator` is given for such settings of the plugin."""


class Emulators:
    """Emulators behind open wires, for the length of a `with` block, in which the variables name them.

    They run in sessions of their own: Ctrl-C in a terminal is for who drives the robots, which are to
    hear its last stop. They end with this process, however that ends.

    Args:
        wires: see `open_wires`.

    Attributes:
        addresses: what each variable was set to.
        poses: where each robot stood at the end of the block, from (0, 0, 0) at its beginning.
    """

    def __init__(self, wires: Sequence[Wire]) -> None:
        self.addresses: dict[str, str] = {}
        self.poses: dict[str, Pose] = {}
        self._wires = wires
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        """Start them, and wait until all of them listen.

        Raises:
            UnavailableError: one has ended instead; it has said why on stderr.
        """
        with ExitStack() as stack:
            programs = [stack.enter_context(self._program(wire)) for wire in self._wires]
            for wire, program in programs:
                self.addresses[wire.variable] = _first_line(wire, program)
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
    def _program(self, wire: Wire) -> Iterator[tuple[Wire, subprocess.Popen[str]]]:
        leash = (sys.executable, "-P", str(eal_actors.cli.leash.__file__))
        module = f"plugins.{wire.plugin}.emulator"
        process = subprocess.Popen(  # noqa: S603  # our own program
            [*leash, module, *_ARGUMENTS[wire.plugin](wire.settings)],
            stdin=subprocess.PIPE,  # the leash
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": str(bundled_path("plugins").parent)},
            start_new_session=True,
        )
        try:
            yield wire, process
        finally:
            said = _ended(process)
            if (pose := _POSE.search(said)) is not None:
                x_m, y_m, yaw_deg = map(float, pose.groups())
                self.poses[wire.robot] = x_m, y_m, yaw_deg


def _first_line(wire: Wire, program: subprocess.Popen[str]) -> str:
    line = program.stdout.readline().strip() if program.stdout is not None else ""
    if not line:
        raise UnavailableError("its emulator has ended; see above", robot=wire.robot)
    return line


def _ended(process: subprocess.Popen[str]) -> str:
    """Let go of the leash, and return what the program says at its end."""
    try:
        return process.communicate(timeout=_STOP_S)[0]
    except subprocess.TimeoutExpired:
        process.kill()
        return process.communicate()[0]
