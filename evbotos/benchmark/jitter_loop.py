"""How late a loop of 50 Hz wakes: at rest, under load and with reading, with ordinary and with real-time priority.

`python3 jitter_loop.py SECONDS` prints a line of JSON per measurement, in microseconds. It needs only Python's standard
library, so it runs on any Linux, also as the first program of a kernel.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable
from time import monotonic_ns, sleep  # noqa: TID251  # it measures the system's own clock

PERIOD_NS = 20_000_000
FIRST_LOOPS = 25
"""Loops that do not count: they load pages and caches."""
PRIORITY = 50


def compute() -> None:
    """Stay in this program."""
    number = 1
    while True:
        number = number * 6364136223846793005 % 18446744073709551557


def call_system() -> None:
    """Stay in long system calls."""
    device = os.open("/dev/urandom", os.O_RDONLY)
    while True:
        os.read(device, 1 << 20)


def read_disk() -> None:
    """Read a file from the disk time and again, which a compressed root unpacks in the kernel."""
    file = os.open(os.path.realpath(sys.executable), os.O_RDONLY)
    while True:
        os.posix_fadvise(file, 0, 0, os.POSIX_FADV_DONTNEED)
        os.lseek(file, 0, os.SEEK_SET)
        while os.read(file, 1 << 20):
            pass


def make_processes() -> None:
    """Copy and end address spaces, with the kernel's locks held."""
    while True:
        child = os.fork()
        if child == 0:
            os._exit(0)
        os.waitpid(child, 0)


LOAD = (compute, call_system, make_processes)
STATES = {"rest": (), "load": LOAD, "load and reading": (*LOAD, read_disk)}


def latenesses_us(seconds: float) -> list[float]:
    """Return how late each wake-up of the loop was, in microseconds.

    The times of all wake-ups are fixed at the start: a late one does not move the next ones.
    """
    late = []
    due_ns = monotonic_ns()
    for loop in range(FIRST_LOOPS + round(seconds * 1e9 / PERIOD_NS)):
        due_ns += PERIOD_NS
        left_ns = due_ns - monotonic_ns()
        if left_ns > 0:
            sleep(left_ns / 1e9)
        if loop >= FIRST_LOOPS:
            late.append((monotonic_ns() - due_ns) / 1e3)
    return late


def start(work: Callable[[], None]) -> int:
    """Start a process of the load, and return its number."""
    child = os.fork()
    if child == 0:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        work()
    return child


def measure(seconds: float, load: tuple[Callable[[], None], ...], policy: int) -> list[float]:
    """Return the latenesses, in order of size, with a load on each processor.

    Raises:
        PermissionError: real-time priority is not permitted.
    """
    os.sched_setscheduler(0, policy, os.sched_param(PRIORITY if policy == os.SCHED_FIFO else 0))
    children = [start(work) for _ in os.sched_getaffinity(0) for work in load]
    try:
        return sorted(latenesses_us(seconds))
    finally:
        for child in children:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)


def main(seconds: float) -> None:
    """Run the six measurements.

    Args:
        seconds: of each.
    """
    for priority, policy in (("ordinary", os.SCHED_OTHER), ("real-time", os.SCHED_FIFO)):
        for state, load in STATES.items():
            try:
                late = measure(seconds, load, policy)
            except PermissionError:
                sys.exit(f"{priority} priority is not permitted: run this as root, or with CAP_SYS_NICE")
            places = {"99 %": len(late) * 99 // 100, "worst": -1}
            found = {name: round(late[place], 1) for name, place in places.items()}
            result = {"priority": priority, "state": state, "loops": len(late), **found}
            print(json.dumps(result), flush=True)  # noqa: T201
    sleep(1)  # a serial console has not sent all yet, and a first program's end stops it


if __name__ == "__main__":
    main(float(sys.argv[1]))
