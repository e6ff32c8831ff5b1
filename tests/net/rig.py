"""Robots served by processes of their own, which tests kill and freeze, and the notes of these robots."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from eal_actors import Fleet
from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import RobotState
from eal_actors.facade.service import RobotService
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.errors import DeadlineError, EALError, UnavailableError
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from tests.net.links import eventually, free_port

PLUGINS = Path(__file__).parent / "plugins"
WAIT_S = 30.0
"""Real seconds after which a test gives up waiting."""
LONGER_THAN_TTL_S = 1.3
"""Real seconds after which a command is too old to begin."""


@dataclass(frozen=True)
class Note:
    """A line of the witness plugin.

    Attributes:
        time_s: the machine's monotonic time.
        robot: the robot.
        event: `begin`, `end`, `halt`, `step` and so on.
        what: the command it is about.
    """

    time_s: float
    robot: str
    event: str
    what: str


class Rig:
    """A fleet file of witness robots with addresses on this machine, and what they write down.

    Args:
        folder: where its files are.
        robots: their names.
        network: the fleet file's section.
        protocol: of the addresses.
        behind: the address of all robots instead, such as `router`.
    """

    def __init__(
        self,
        folder: Path,
        robots: Sequence[str] = ("r1",),
        network: Mapping[str, object] | None = None,
        *,
        protocol: str = "tcp",
        behind: str | None = None,
        extra: Mapping[str, object] | None = None,
    ) -> None:
        self.folder = folder
        self.notes_file = folder / "notes.txt"
        self.file = folder / "f.yaml"
        self.content: dict[str, Any] = {
            "version": 1,
            "name": "f",
            "plugin_dirs": [str(PLUGINS)],
            "network": dict(network or {}),
            "robots": {
                name: {
                    "address": behind or f"{protocol}/127.0.0.1:{free_port()}",
                    "timeout_s": WAIT_S,
                    "plugins": {"witness": {"file": str(self.notes_file)}},
                }
                for name in robots
            },
            **(extra or {}),
        }
        self.write()

    def write(self) -> None:
        """Write the fleet file: JSON is YAML too."""

        self.file.write_text(json.dumps(self.content), encoding="utf-8")

    @property
    def config(self) -> FleetConfig:
        """The fleet."""
        return EALConfigManager.load(self.file).fleet

    def local(self) -> FleetConfig:
        """The same fleet without its network."""
        config = self.config
        robots = {name: replace(robot, address=None, listen=None) for name, robot in config.robots.items()}
        return replace(config, robots=robots)

    @contextmanager
    def served_here(self) -> Iterator[Fleet]:
        """Serve all robots in this process, and connect to them through the network."""
        with ExitStack() as stack:
            config = self.config
            for name in config.robots:
                stack.enter_context(RobotService(config, name))
            yield stack.enter_context(ready(Fleet(config)))

    def notes(self, *events: str, robot: str | None = None) -> list[Note]:
        """Return the notes so far of these events."""
        if not self.notes_file.exists():
            return []
        lines = [line.split() for line in self.notes_file.read_text(encoding="utf-8").splitlines()]
        notes = [Note(float(time_s), name, event, what) for time_s, name, event, what in lines]
        return [note for note in notes if note.event in events and robot in (None, note.robot)]

    def begun(self, what: str) -> bool:
        """Wait until a command begins; return whether it does in time."""
        return eventually(lambda: any(note.what == what for note in self.notes("begin")))

    def steps(self) -> list[str]:
        """Return the numbers that were stepped, in their order."""
        return [note.what for note in self.notes("step")]

    def never_twice(self) -> bool:
        """Return whether the robots' commands ran one at a time and once each."""
        begun = [(note.robot, note.what) for note in self.notes("begin", "step")]
        return len(begun) == len(set(begun))


@contextmanager
def ready(fleet: Fleet) -> Iterator[Fleet]:
    """Connect a fleet and wait for all its robots."""
    with fleet:
        for robot in fleet.values():
            assert becomes(robot, RobotState.READY), robot.problems
        yield fleet


def becomes(robot: RobotHandle, state: RobotState) -> bool:
    """Wait for a robot's state; return whether it is reached in time."""
    return eventually(lambda: robot.state is state)


def failure(future: Any, kind: type[EALError]) -> EALError:
    """Return the error of a kind with which a call fails."""
    error = future.exception(timeout=WAIT_S)
    assert isinstance(error, kind), repr(error)
    return error


class Process:
    """A program in a process of its own, whose output is read continuously.

    Args:
        arguments: of the Python interpreter.
        folder: where it runs.
        within: the command that runs it, such as one that enters a network namespace; it takes its place.
    """

    def __init__(self, arguments: Sequence[str], folder: Path, within: Sequence[str] = ()) -> None:
        unwanted = {"COLUMNS", "EAL_FLEET", "FORCE_COLOR"}
        environment = {name: value for name, value in os.environ.items() if name not in unwanted}
        self.lines: list[str] = []
        self._changed = threading.Condition()
        self._popen = subprocess.Popen(
            [*within, sys.executable, *arguments],
            cwd=folder,
            env={**environment, "PYTHONPATH": str(bundled_path("."))},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self._reader = threading.Thread(target=self._read, name=f"output of {self._popen.pid}")
        self._reader.start()

    @classmethod
    def serving(cls, fleet: Path, robot: str) -> Self:
        """Serve a robot of a fleet file."""
        return cls(["-m", "eal_actors", "serve", "--fleet", str(fleet), "--robot", robot], fleet.parent)

    @property
    def pid(self) -> int:
        """Its number."""
        return self._popen.pid

    def _read(self) -> None:
        assert self._popen.stdout is not None
        for line in self._popen.stdout:
            with self._changed:
                self.lines.append(line)
                self._changed.notify_all()
        with self._changed:
            self.lines.append("")
            self._changed.notify_all()

    def wait_for(self, *words: str) -> Self:
        """Wait until a line of its output holds one of the texts."""
        with self._changed:
            assert self._changed.wait_for(lambda: self._has(*words) or "" in self.lines, WAIT_S), self.lines
            assert self._has(*words), f"{words!r} never came: {''.join(self.lines)}"
        return self

    def wait_until_listening(self) -> Self:
        """Wait until the robot is discoverable."""
        return self.wait_for("listening at", "dials out to")

    def _has(self, *words: str) -> bool:
        return any(text in line for line in self.lines for text in words)

    def signal(self, number: signal.Signals) -> None:
        """Send it a signal."""
        self._popen.send_signal(number)

    def kill(self) -> None:
        """Kill the process and wait for its end."""
        self._popen.kill()
        self._popen.wait(WAIT_S)

    def freeze(self) -> None:
        """Freeze all threads of the process; return once they are stopped."""
        self.signal(signal.SIGSTOP)
        os.waitid(os.P_PID, self.pid, os.WSTOPPED)

    def thaw(self) -> None:
        """Continue the frozen process."""
        self.signal(signal.SIGCONT)

    def wait(self) -> int:
        """Wait until the process ends; return its exit code."""
        return self._popen.wait(WAIT_S)

    def memory_bytes(self) -> int:
        """Return the resident memory of the process."""
        fields = Path(f"/proc/{self.pid}/statm").read_text(encoding="ascii").split()
        return int(fields[1]) * os.sysconf("SC_PAGE_SIZE")

    def peak_memory_bytes(self) -> int:
        """Return the most resident memory that the process has taken."""
        lines = Path(f"/proc/{self.pid}/status").read_text(encoding="ascii").splitlines()
        return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))

    def end(self) -> None:
        """Kill the process and close its pipes."""
        self.kill()
        self._reader.join(WAIT_S)
        assert self._popen.stdout is not None
        self._popen.stdout.close()


@contextmanager
def process(arguments: Sequence[str], folder: Path) -> Iterator[Process]:
    """Run a program for the length of a `with` block."""
    running = Process(arguments, folder)
    try:
        yield running
    finally:
        running.end()


class Servers:
    """The servers of a fleet's robots.

    Args:
        fleet: the fleet file.
    """

    def __init__(self, fleet: Path) -> None:
        self._fleet = fleet
        self._stack = ExitStack()
        self._running: dict[str, Process] = {}

    def __getitem__(self, robot: str) -> Process:
        return self._running[robot]

    def start(self, *robots: str) -> None:
        """Start or restart the servers of robots and wait until they are discoverable."""
        for robot in robots:
            if robot in self._running:
                self._running[robot].end()
            self._running[robot] = server = Process.serving(self._fleet, robot)
            self._stack.callback(server.end)
        for robot in robots:
            self._running[robot].wait_until_listening()

    def close(self) -> None:
        """Kill all servers."""
        self._stack.close()


@contextmanager
def serving(fleet: Path, *robots: str) -> Iterator[Servers]:
    """Serve robots of a fleet file by processes of their own for the length of a `with` block."""
    running = Servers(fleet)
    try:
        running.start(*robots)
        yield running
    finally:
        running.close()


@contextmanager
def servers(rig: Rig, *robots: str) -> Iterator[Servers]:
    """Serve robots of a rig, all if none are named, in the same way."""
    with serving(rig.file, *(robots or rig.config.robots)) as running:
        yield running


@contextmanager
def served(rig: Rig) -> Iterator[tuple[Servers, Fleet]]:
    """Serve all robots of a rig by processes, and connect to them."""
    with servers(rig) as running, ready(Fleet(rig.config)) as fleet:
        yield running, fleet


_OTHER_CLOCK = """
import sys
import time
real = time.monotonic
time.monotonic = lambda: real() + {shift_s}
from eal_actors.cli import main
sys.argv = ["eal", "serve", "--fleet", sys.argv[1], "--robot", "r1"]
main()
"""


def other_clock(shift_s: float) -> str:
    """Return a program that serves the robot `r1` of a fleet file with a clock that is ahead by so many seconds."""
    return _OTHER_CLOCK.format(shift_s=shift_s)


def outlast_ttl(robot: RobotHandle) -> None:
    """Let a frozen robot leave a reading unanswered for longer than a command may wait.

    On a busy machine its lease may end before the deadline of the call does.
    """
    error = robot["Gauge"].get_value(timeout_s=LONGER_THAN_TTL_S).exception(timeout=WAIT_S)
    assert isinstance(error, DeadlineError | UnavailableError), repr(error)


def hold_calls(robot: RobotHandle) -> threading.Event:
    """Hold the outgoing calls to a robot's fleet back until the event is set."""
    gate = threading.Event()
    robot._actor._controller.sender.submit(lambda _: gate.wait(WAIT_S))  # type: ignore[attr-defined]
    return gate
