"""The memory of this process: how the C library hands it out, and how much room is left.

glibc makes a heap for nearly each thread, up to eight for each processor. A thread that ends leaves what it
freed to its heap, where only the threads that glibc assigns to that heap can use it. Threads of the network come and go
with links and sessions, so one heap after another fills with free memory. In soaks of ten minutes, a controller of 20
robots grew by 20 MB, nearly all of it free memory, and by 4 MB with two heaps.

The limit counts for new heaps only. So `limit_heaps` precedes the threads of a fleet: a controller's threads had made
nine heaps before its session opened.

Python's own objects are not affected: they come from Python's allocator.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from eal_actors.kernel.posix import HAS_LIMITS, resource

_M_TRIM_THRESHOLD: Final = -1
_M_MMAP_THRESHOLD: Final = -3
_M_ARENA_MAX: Final = -8
_ARENAS: Final = 2
"""Heaps of a process. A minute of messages of 900 MB took a robot from 82 to 125 MB, once to 134 MB, and to 104 MB with
this."""
_ARENAS_VARIABLE: Final = "MALLOC_ARENA_MAX"
_LARGE_BYTES: Final = 2**20
"""Size from which glibc returns a buffer to the system when it is freed. Its own size grows with the largest buffer
freed. Eight refused messages of 900 MiB took a robot from 100 to 130 MB, and to 121 MB with this."""
_KEPT_BYTES: Final = 4 * 2**20
"""Free memory that each heap keeps. glibc's 128 kB, which stay if the size above is set, give the memory of each image
back and take it again: 190 page faults, a quarter of the time of an image of 921,600 bytes over TCP."""

_SHORT_BYTES: Final = 24 * 1024**2
"""Room below which memory is short. A link of 1 Gbit/s brings 6 MB between two looks of its watch, and the network
engine keeps more than that: on a busy machine, a flood of keys over loopback took 139 MB with 16 MB of room, and 125 MB
with 24."""
_GROWN_BYTES: Final = 8 * 1024**2
"""Growth below which this process is not the one that fills the memory."""
_STATM: Final = Path("/proc/self/statm")
_MEMINFO: Final = Path("/proc/meminfo")
_CGROUPS: Final = Path("/sys/fs/cgroup")
_PAGE: Final = os.sysconf("SC_PAGE_SIZE") if HAS_LIMITS else 0


def limit_heaps() -> None:
    """Limit the heaps of glibc, unless the user has; nothing with another C library. Thread: any, best the first."""
    if _ARENAS_VARIABLE not in os.environ:
        _set(_M_ARENA_MAX, _ARENAS)


def return_buffers() -> None:
    """Return large buffers to the system soon, where strangers choose the sizes of messages. Thread: any."""
    _set(_M_MMAP_THRESHOLD, _LARGE_BYTES)
    _set(_M_TRIM_THRESHOLD, _KEPT_BYTES)


def _set(parameter: int, value: int) -> None:
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).mallopt(parameter, value)


class MemoryRoom:
    """Compares this process's memory with its own limits, those of its cgroups and the machine's. Thread: one.

    Memory is short only if this process has grown too: on a machine that others fill, ending links would not help. Each
    limit counts, since whichever is reached first ends the process. Linux; memory is never short elsewhere.
    """

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
        if resident - self._least_bytes < _GROWN_BYTES:
            return False
        limits = (resource.RLIMIT_AS, size), (resource.RLIMIT_DATA, data)
        soft = ((resource.getrlimit(which)[0], used) for which, used in limits)
        rooms = [limit - used for limit, used in soft if limit != resource.RLIM_INFINITY]
        if self._cgroup_bytes is not None:
            rooms.append(self._cgroup_bytes - resident)
        return min([*rooms, *_available()], default=_SHORT_BYTES) < _SHORT_BYTES

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
