"""How the engine divides its work between threads.

Left to itself, the engine registers a link's socket with the threads that accept or dial, while other threads
read it: each message wakes three threads one after another, of which one moves its bytes. Here the threads that read
also accept and dial, so one thread waits for the socket and reads it. A call and its reply take 16 µs less on one core,
a tenth, and eight callers get a quarter more replies. The threads that send stay apart, so a link whose messages the
process does not take still sends its keep-alives.

Sharing one thread among all four saves no more. The engine's low-latency transport, without a thread that sends, would
save as much again, but it has no priorities: a stop would wait behind every image.
"""

from __future__ import annotations

import os
from typing import Final

_THREADS_VARIABLE: Final = "ZENOH_RUNTIME"
_SHARED_THREADS: Final = "(acc: (handover: rx), net: (handover: rx))"


def share_threads() -> None:
    """Set the engine's threads, unless the user has. Thread: any; without effect once the process has had a session."""
    os.environ.setdefault(_THREADS_VARIABLE, _SHARED_THREADS)
