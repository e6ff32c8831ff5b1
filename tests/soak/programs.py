"""Programs in processes of their own, which can be killed and frozen; what they say goes to files."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from eal_actors.kernel.bundled import bundled_path

WAIT_S: Final = 60.0
_ENGINE: Final = re.compile(r"(acc|app|net|rx|tx)-\d+")


@dataclass(frozen=True)
class Sample:
    """The resources of a process at one time.

    Attributes:
        time_s: the machine's monotonic time.
        memory_bytes: its resident set.
        threads: how many of them are its own.
        engine_threads: how many more the network's engine has, which keeps pools of them.
        files: how many it has open.
        shared: the segments of shared memory that it has mapped or open.
    """

    time_s: float
    memory_bytes: int
    threads: int
    engine_threads: int
    files: int
    shared: frozenset[str]


class Program:
    """A Python program.

    Args:
        name: whose it is, and of its log.
        arguments: of the interpreter.
        folder: where it runs and where its log is.
    """

    def __init__(self, name: str, arguments: Sequence[str], folder: Path) -> None:
        unwanted = {"COLUMNS", "EAL_FLEET", "FORCE_COLOR"}
        environment = {key: value for key, value in os.environ.items() if key not in unwanted}
        self.name = name
        self.log = folder / f"{name}.log"
        with self.log.open("ab") as log:
            self._popen = subprocess.Popen(
                [sys.executable, *arguments],
                cwd=bundled_path("."),
                env={**environment, "PYTHONPATH": str(bundled_path("."))},
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    @property
    def pid(self) -> int:
        """Its number."""
        return self._popen.pid

    @property
    def exit_code(self) -> int | None:
        """The exit code; None while it runs."""
        return self._popen.poll()

    def freeze(self) -> None:
        """Stop all its threads where they are, and return once they stand."""
        self._popen.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, self.pid, os.WSTOPPED | os.WNOWAIT)

    def thaw(self) -> None:
        """Let it go on."""
        self._popen.send_signal(signal.SIGCONT)

    def kill(self) -> None:
        """End it on the spot."""
        self._popen.kill()
        self._popen.wait(WAIT_S)
        self._close()

    def end(self, *, by_signal: bool) -> int:
        """Ask it to end, by SIGTERM or by the end of its input, and return its exit code."""
        if by_signal:
            self._popen.terminate()
        self._close()
        return self._popen.wait(WAIT_S)

    def _close(self) -> None:
        assert self._popen.stdin is not None
        self._popen.stdin.close()

    def sample(self, time_s: float) -> Sample:
        """Return what it takes now."""
        proc = Path(f"/proc/{self.pid}")
        pages = int((proc / "statm").read_text(encoding="ascii").split()[1])
        links = []
        for link in (proc / "fd").iterdir():
            try:
                links.append(str(link.readlink()))
            except FileNotFoundError:  # closed meanwhile
                continue
        maps = (line.split(maxsplit=5)[-1].strip() for line in (proc / "maps").read_text().splitlines())
        shared = {path.removesuffix(" (deleted)") for path in (*links, *maps) if path.startswith("/dev/shm/")}  # noqa: S108
        engine = [_is_engine(task) for task in (proc / "task").iterdir()]
        memory_bytes, threads = pages * os.sysconf("SC_PAGE_SIZE"), engine.count(False)
        return Sample(time_s, memory_bytes, threads, engine.count(True), len(links), frozenset(shared))


def _is_engine(task: Path) -> bool:
    """Return whether a thread is one of zenoh's, by its name; one that has ended meanwhile was."""
    try:
        return _ENGINE.fullmatch((task / "comm").read_text().strip()) is not None
    except OSError:
        return True
