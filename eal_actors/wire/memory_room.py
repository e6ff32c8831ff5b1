"""MemoryRoom: how much memory this process may still take, and whether that is little. Linux; nothing elsewhere.

Memory is short only if this process has grown too: on a machine that others fill, ending links would not help. Each
limit counts, since whichever is reached first ends the process.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from eal_actors.kernel.posix import HAS_LIMITS, resource

SHORT_BYTES: Final = 24 * 1024**2
"""Room below which memory is short. A link of 1 Gbit/s brings 6 MB between two looks of the watch, and the engine keeps
more than that: on a busy machine, a flood of keys over loopback took 139 MB with 16 MB of room, and 125 MB with 24.
"""
GROWN_BYTES: Final = 8 * 1024**2
"""Growth below which this process is not the one that fills the memory."""
_STATM: Final = Path("/proc/self/statm")
_MEMINFO: Final = Path("/proc/meminfo")
_CGROUPS: Final = Path("/sys/fs/cgroup")
_PAGE: Final = os.sysconf("SC_PAGE_SIZE") if HAS_LIMITS else 0


class MemoryRoom:
    """Compares this process's memory with its own limits, those of its cgroups and the machine's. Thread: one."""

    def __init__(self) -> None:
        self._cgroup_bytes = min(_cgroup_limits(), default=None)
        self._least_bytes = 0

    def is_short(self) -> bool:
        """Return whether little memory is left and this process has grown."""
        try:
            size, resident, _, _, _, data, _ = (int(pages) * _PAGE for pages in _STATM.read_bytes().split())
        except (OSError, ValueError):  # another system, or no descriptor is free
            return False
        self._least_bytes = min(self._least_bytes or resident, resident)
        if resident - self._least_bytes < GROWN_BYTES:
            return False
        limits = (resource.RLIMIT_AS, size), (resource.RLIMIT_DATA, data)
        soft = ((resource.getrlimit(which)[0], used) for which, used in limits)
        rooms = [limit - used for limit, used in soft if limit != resource.RLIM_INFINITY]
        if self._cgroup_bytes is not None:
            rooms.append(self._cgroup_bytes - resident)
        return min([*rooms, *_available()], default=SHORT_BYTES) < SHORT_BYTES

    def free(self) -> None:
        """Return unused memory to the system, as far as the C library can."""
        with contextlib.suppress(AttributeError):  # another C library
            ctypes.CDLL(None).malloc_trim(0)


def _available() -> Iterator[int]:
    """Yield the memory that the machine has for new processes."""
    with contextlib.suppress(OSError):
        for line in _MEMINFO.read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                yield 1024 * int(line.split()[1])


def _cgroup_limits() -> Iterator[int]:
    """Yield the limits of the cgroups (version 2) that this process is in."""
    with contextlib.suppress(OSError, ValueError):
        (path,) = (
            line[3:] for line in Path("/proc/self/cgroup").read_text(encoding="utf-8").splitlines() if line[:3] == "0::"
        )
        group = _CGROUPS / path.strip("/")
        for folder in (group, *group.parents):
            limit = folder / "memory.max"
            if folder.is_relative_to(_CGROUPS) and limit.is_file() and (text := limit.read_text().strip()) != "max":
                yield int(text)
