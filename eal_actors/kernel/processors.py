"""The threads of a crowd of robots share one processor.

One thread at a time runs Python. Where many wake each other, the interpreter's lock is handed from processor to
processor, which costs more than the work: with 1,000 robots in a process, a command over the network took 156 µs of
processor time on two processors and 75 µs on one. Few threads seldom compete, and their native code, such as OpenCV's,
can use further processors; they stay as they are.

Thread: any; the setting is the calling thread's, and the threads that it starts inherit it. Linux; elsewhere nothing
changes.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

CROWD: Final = 8
"""Robots of one process from which their threads share a processor."""


@contextmanager
def sharing_processor(robots: int) -> Iterator[None]:
    """Let the threads that start in a `with` block stay on one processor, if their process has a crowd of robots."""
    if robots < CROWD or not hasattr(os, "sched_setaffinity"):
        yield
        return
    allowed = os.sched_getaffinity(0)
    chosen = sorted(allowed)[os.getpid() % len(allowed)]  # several processes spread
    os.sched_setaffinity(0, {chosen})
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)
