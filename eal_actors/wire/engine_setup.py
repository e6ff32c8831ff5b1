"""How the engine divides its work between threads, and how the C library hands out memory in a process with a session.

Threads. Left to itself, the engine registers a link's socket with the threads that accept or dial, while other threads
read it: each message wakes three threads one after another, of which one moves its bytes. Here the threads that read
also accept and dial, so one thread waits for the socket and reads it. A call and its reply take 16 µs less on one core,
a tenth, and eight callers get a quarter more replies. The threads that send stay apart, so a link whose messages the
process does not take still sends its keep-alives.

Sharing one thread among all four saves no more. The engine's low-latency transport, without a thread that sends, would
save as much again, but it has no priorities: a stop would wait behind every image.

Memory. glibc makes a heap for nearly each thread, up to eight for each processor. A thread that ends leaves what it
freed to its heap, where only the threads that glibc assigns to that heap can use it. Threads of the engine and of this
package come and go with links and sessions, so one heap after another fills with free memory. In soaks of ten minutes,
a controller of 20 robots grew by 20 MB, nearly all of it free memory, and by 4 MB with two heaps.

The limit counts for new heaps only. So `limit_heaps` precedes the threads of a fleet: a controller's threads had made
nine heaps before its session opened.

Python's own objects are not affected: they come from Python's allocator.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
from typing import Final

_THREADS_VARIABLE: Final = "ZENOH_RUNTIME"
_SHARED_THREADS: Final = "(acc: (handover: rx), net: (handover: rx))"
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


def share_threads() -> None:
    """Set the engine's threads, unless the user has. Thread: any; without effect once the process has had a session."""
    os.environ.setdefault(_THREADS_VARIABLE, _SHARED_THREADS)


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
