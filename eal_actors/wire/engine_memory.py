"""How the C library hands out memory in a process with a session.

glibc makes a heap for nearly each thread, up to eight for each processor. A thread that ends leaves what it freed to
its heap, where only the threads that glibc assigns to that heap can use it. Threads of the engine and of this package
come and go with links and sessions, so one heap after another fills with free memory. In soaks of ten minutes, a
controller of 20 robots grew by 20 MB, nearly all of it free memory, and by 4 MB with two heaps.

The limit counts for new heaps only. So `limit_heaps` precedes the threads of a fleet: a controller's threads had made
nine heaps before its session opened.

Python's own objects are not affected: they come from Python's allocator.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
from typing import Final

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
