"""One get_value through facade and actor, against one bare Pykka ask.

Pinned to one core: across cores a hop costs whatever the kernel's scheduler makes of it, for both.
"""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable
from typing import Any

import pykka

import eal_actors
from tests.benchmarks.result import Result


class Bare(pykka.ThreadingActor):
    """Answers every message with an int."""

    def on_receive(self, message: Any) -> int:
        return 0


def median_us(action: Callable[[], object], times: int) -> float:
    """Return the median duration in microseconds."""
    durations = []
    for _ in range(times):
        start = time.perf_counter()
        action()
        durations.append(time.perf_counter() - start)
    return statistics.median(durations) * 1e6


def run() -> list[Result]:
    """Measure in fifteen turns each; the median turn counts."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    reference = Bare.start()
    try:
        with eal_actors.connect() as eal:
            sample = eal.find_resource("SampleResource")
            turns = [
                (median_us(lambda: eal.get_value(sample), 400), median_us(lambda: reference.ask("value"), 400))
                for _ in range(15)
            ]
    finally:
        reference.stop()
        os.sched_setaffinity(0, cores)
    ours, bare = (statistics.median(column) for column in zip(*turns, strict=True))
    ratio = statistics.median(mine / theirs for mine, theirs in turns)
    what = "get_value, facade to actor and back, one core"
    return [Result(what, f"{ours:.1f} µs", f"bare Pykka ask: {bare:.1f} µs", ratio, 1.6)]
