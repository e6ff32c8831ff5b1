"""When processes were ready to run and had no processor, by the kernel's own account: what a busy machine does to them.

A heartbeat that waits for a processor is as silent as one that a frozen process does not send. Waiting for a lock, for
the interpreter or for a frozen process counts for nothing here: that would be the project's own doing.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from eal_actors.kernel.clock import REAL_TIME, acquire_alert, new_waiter
from tests.soak.history import History, Interval

HUNGRY_S: Final = 0.25
"""From how long on it counts, of one thread between two looks: a heartbeat's period, a quarter of the lease."""


_LOOK_EACH_S: Final = 0.5


class Hunger:
    """Looks at processes, again and again. Thread: one."""

    def __init__(self) -> None:
        self._seen: dict[int, tuple[float, dict[str, float]]] = {}

    def look(self, pid: int, time_s: float) -> tuple[Interval, float] | None:
        """Return the time since the last look, or as long before as one thread has waited, and how long it has.

        None if none has, or the process has ended.

        Args:
            pid: of the process.
            time_s: the machine's monotonic time now.
        """
        waited = _waited_s(pid)
        last_s, before = self._seen.get(pid, (time_s, {}))
        self._seen[pid] = time_s, waited
        longest_s = max((waited[thread] - before[thread] for thread in waited.keys() & before.keys()), default=0.0)
        return ((time_s - max(longest_s, time_s - last_s), time_s), longest_s) if longest_s > 0.0 else None


@contextmanager
def watching(pids: Callable[[], Mapping[str, int]], history: History) -> Iterator[None]:
    """Note when processes wait for a processor, for the length of a `with` block.

    Args:
        pids: returns whom to look at, by name. Thread: one of the watch's own.
        history: where to note it.
    """
    hunger, ends = Hunger(), new_waiter()

    def watch() -> None:
        while not acquire_alert(ends, _LOOK_EACH_S):
            for name, pid in pids().items():
                if (wait := hunger.look(pid, time.clock_gettime(time.CLOCK_MONOTONIC))) is not None:
                    if wait[1] >= HUNGRY_S:
                        history.hungry.setdefault(name, []).append(wait[0])
                    else:
                        history.waits.setdefault(name, []).append(wait)

    thread = threading.Thread(target=watch, name="hunger")
    thread.start()
    try:
        yield
    finally:
        REAL_TIME.wake(ends)
        thread.join()


def _waited_s(pid: int) -> dict[str, float]:
    """Return for how many seconds each thread of a process has waited for a processor since it began."""
    waited = {}
    try:
        for task in Path(f"/proc/{pid}/task").iterdir():
            waited[task.name] = int((task / "schedstat").read_text(encoding="ascii").split()[1]) / 1e9
    except OSError:  # the process has ended, or this thread of it has; a kernel without the account tells nothing
        return waited
    return waited
