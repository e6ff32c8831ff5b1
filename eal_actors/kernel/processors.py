"""How the system schedules the threads of a process with a fleet, of which one at a time runs Python.

A thread that wakes another one still has the interpreter's lock. Where the system lets the woken thread preempt it,
that one finds the lock taken and sleeps again: two switches of threads for nothing, up to three times in a remote call.
With SCHED_BATCH there is no such preemption (Source: sched(7)).

Where many threads wake each other, the lock is handed from processor to processor, which costs more than the work: with
1,000 robots in a process, a command over the network took 156 µs of processor time on two processors and 75 µs on one.
So the threads of a crowd of robots share one. Few threads seldom compete, and their native code, such as OpenCV's, can
use further processors; they stay as they are.

Thread: any; the settings are the calling thread's, and the threads that it starts inherit them. Linux; elsewhere
nothing changes.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

CROWD: Final = 8
"""Robots of one process from which their threads share a processor."""


def take_turns() -> None:
    """Let threads run on when they wake others, unless the user has chosen a policy of scheduling."""
    if hasattr(os, "SCHED_BATCH") and os.sched_getscheduler(0) == os.SCHED_OTHER:
        with contextlib.suppress(OSError):  # a container may forbid it
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


@contextmanager
def sharing_processor(robots: int) -> Iterator[None]:
    """Let the threads that start in a `with` block stay on one processor, if their process has a crowd of robots."""
    if robots < CROWD or not hasattr(os, "sched_setaffinity"):
        yield
        return
    allowed = os.sched_getaffinity(0)
    chosen = sorted(allowed)[os.getpid() % len(allowed)]  # several processes spread
    with contextlib.suppress(OSError):  # a container may forbid it
        os.sched_setaffinity(0, {chosen})
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            os.sched_setaffinity(0, allowed)
