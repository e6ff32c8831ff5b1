"""A thousand resource actors: starting them, what each weighs, one command to all and all answers gathered."""

from __future__ import annotations

import statistics
import time
from pathlib import Path
from typing import Any

import pykka

from eal_actors import gather
from eal_actors.device.resource import Resource, command
from tests.benchmarks.hop import Bare
from tests.benchmarks.result import Result
from tests.robots import running_robot

ACTORS = 1000


class Lamp(Resource):
    """A resource with one command."""

    @command("on")
    def on(self) -> int:
        return 1


def resident_bytes() -> int:
    """Return the memory that this process holds in RAM."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def bare_round(references: list[pykka.ActorRef[Any]]) -> float:
    start = time.perf_counter()
    pykka.get_all([reference.ask("on", block=False) for reference in references])
    return time.perf_counter() - start


def run() -> list[Result]:
    """Measure commands in eleven turns with bare Pykka; the median turn counts."""
    start = time.perf_counter()
    references = [Bare.start() for _ in range(ACTORS)]
    bare_start_s = time.perf_counter() - start
    names = [f"Lamp{number}" for number in range(ACTORS)]
    before = resident_bytes()
    start = time.perf_counter()
    with running_robot(dict.fromkeys(names, Lamp)) as robot:
        start_s = time.perf_counter() - start
        weight = (resident_bytes() - before) / ACTORS
        lamps = [robot[name] for name in names]
        turns = []
        for _ in range(11):
            begin = time.perf_counter()
            answers = gather([lamp.send_cmd("on") for lamp in lamps]).get()
            turns.append((time.perf_counter() - begin, bare_round(references)))
            if answers != [1] * ACTORS:
                raise AssertionError("not every lamp is on")
    for reference in references:
        reference.stop()
    ours, bare = (statistics.median(column) for column in zip(*turns, strict=True))
    ratio = statistics.median(mine / theirs for mine, theirs in turns)
    return [
        Result("start of 1,000 resource actors", f"{start_s:.2f} s", f"bare: {bare_start_s:.2f} s", start_s, 3, "s"),
        Result("memory of a resource actor", f"{weight / 1000:.0f} kB", "resident set", weight / 1000, 100, "kB"),
        Result(
            "one command to 1,000 actors, answers gathered",
            f"{ours * 1e3:.0f} ms",
            f"bare Pykka: {bare * 1e3:.0f} ms",
            ratio,
            2.0,
        ),
    ]
