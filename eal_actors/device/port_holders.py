"""The programs that have a port of this machine: a serial port that is open, or a TCP port at which they listen.

Root sees all programs, other users only their own. Linux; elsewhere no program is seen.
"""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

_TABLES: Final = Path("/proc/net/tcp"), Path("/proc/net/tcp6")
_LISTENS: Final = "0A"


@dataclass(frozen=True, slots=True)
class PortHolder:
    """A program that has a port open."""

    pid: int
    program: str

    def __str__(self) -> str:
        """Return both, for messages. The program may be this one, with an earlier fleet that was not closed."""
        return f"{'this program' if self.pid == os.getpid() else self.program} (pid {self.pid})"


def holders(path: Path) -> Iterator[PortHolder]:
    """Yield the programs that have a device open."""
    try:
        number = path.stat().st_rdev
    except OSError:
        return
    yield from _programs(lambda status: stat.S_ISCHR(status.st_mode) and status.st_rdev == number)


def listeners(port: int) -> Iterator[PortHolder]:
    """Yield the programs that listen at a TCP port. Source: the kernel's Documentation/networking/proc_net_tcp.rst."""
    sockets: set[int] = set()
    for table in _TABLES:
        with contextlib.suppress(OSError):  # this kernel has no IPv6
            rows = (line.split() for line in table.read_text(encoding="ascii").splitlines()[1:])
            sockets.update(
                int(row[9]) for row in rows if row[3] == _LISTENS and int(row[1].rpartition(":")[2], 16) == port
            )
    yield from _programs(lambda status: stat.S_ISSOCK(status.st_mode) and status.st_ino in sockets)


def _programs(is_port: Callable[[os.stat_result], bool]) -> Iterator[PortHolder]:
    """Yield the programs one of whose open files is the port."""
    for process in sorted(Path("/proc").glob("[0-9]*"), key=lambda process: int(process.name)):
        with contextlib.suppress(OSError):  # it has ended, or belongs to another user
            if any(_is(descriptor, is_port) for descriptor in (process / "fd").iterdir()):
                program = (process / "comm").read_text(encoding="utf-8", errors="replace").strip()
                yield PortHolder(int(process.name), program)


def _is(descriptor: Path, is_port: Callable[[os.stat_result], bool]) -> bool:
    try:
        return is_port(descriptor.stat())
    except OSError:  # it was closed meanwhile
        return False
