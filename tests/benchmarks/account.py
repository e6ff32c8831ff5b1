"""Where the time of a remote call goes: microseconds between the stations of its path, at both ends.

Run as `python -m tests.benchmarks.account`: it prints a table in Markdown, which docs/network-account.md holds. Each
station is a method that the path enters or leaves; a wrapper notes the time of the system's clock there, which both
processes share. One core; the median of the calls counts. A wrapper adds about half a microsecond.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from eal_actors import Fleet
from eal_actors.actors.actor import Inbox
from eal_actors.actors.future import Future
from eal_actors.actors.resource_actor import ResourceActor
from eal_actors.wire.rpc.client.controller import Controller
from eal_actors.wire.rpc.server.host import RobotHost
from eal_actors.wire.transport import Transport
from tests.benchmarks import network_host
from tests.benchmarks.network_host import fleet_of
from tests.net.links import free_port

ROOT: Final = Path(__file__).parents[2]
CALLS: Final = 400
WARM_UP: Final = 100

Station = tuple[str, type, str, bool]
"""Name, class, method, and whether its entry (True) or its exit counts."""

CONTROLLER: Final[tuple[Station, ...]] = (
    ("the call is encoded and goes to the engine", Transport, "put", True),
    ("the engine has it", Transport, "put", False),
    ("the answer is received", Controller, "_on_answer", True),
    ("the caller is woken", Future, "settle", False),
)
ROBOT: Final[tuple[Station, ...]] = (
    ("the call is received", RobotHost, "_on_call", True),
    ("it is in the mailbox", Inbox, "put", False),
    ("the resource begins", ResourceActor, "_execute", True),
    ("the answer is encoded and goes to the engine", Transport, "put", True),
    ("the engine has the answer", Transport, "put", False),
)
LEGS: Final = (
    ("controller", "handle, checks, header", "the call is encoded and goes to the engine"),
    ("controller", "engine takes the call", "the engine has it"),
    ("engine", "link to the robot, reader wakes", "the call is received"),
    ("robot", "decode, admit, mailbox", "it is in the mailbox"),
    ("robot", "the resource's thread wakes", "the resource begins"),
    ("robot", "method, outcome, encode, outbox", "the answer is encoded and goes to the engine"),
    ("robot", "engine takes the answer", "the engine has the answer"),
    ("engine", "link to the controller, reader wakes", "the answer is received"),
    ("controller", "decode, find the call, set the outcome", "the caller is woken"),
    ("controller", "the caller wakes", "end"),
)
"""End, what happens, and the station at which it is over."""

notes: list[tuple[str, int]] = []


def observe(stations: tuple[Station, ...]) -> None:
    """Note the times at which the stations are passed."""
    for name, owner, method, is_entry in stations:
        setattr(owner, method, _noting(getattr(owner, method), name, is_entry=is_entry))


def _noting(method: Callable[..., Any], name: str, *, is_entry: bool) -> Callable[..., Any]:
    def at_entry(*args: Any, **kwargs: Any) -> Any:
        notes.append((name, time.monotonic_ns()))
        return method(*args, **kwargs)

    def at_exit(*args: Any, **kwargs: Any) -> Any:
        try:
            return method(*args, **kwargs)
        finally:
            notes.append((name, time.monotonic_ns()))

    return at_entry if is_entry else at_exit


def serve() -> None:
    """Serve one robot, and print the notes when the standard input ends."""
    observe(ROBOT)
    network_host.main()
    sys.stdout.write(json.dumps(notes) + "\n")
    sys.stdout.flush()


def measure(call: Callable[[Any], object], port: int) -> dict[str, float]:
    """Return the median microseconds of each leg."""
    robot = subprocess.Popen(
        [sys.executable, "-m", "tests.benchmarks.account", "1", str(port)],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert robot.stdin is not None
    assert robot.stdout is not None
    try:
        assert robot.stdout.readline() == "up\n"
        spans: list[tuple[int, int]] = []
        with Fleet(fleet_of(1, port)) as fleet:
            lamp = fleet["bot1"]["Lamp"]
            for _ in range(WARM_UP + CALLS):
                start = time.monotonic_ns()
                call(lamp)
                spans.append((start, time.monotonic_ns()))
        robot.stdin.close()
        every = sorted([*notes, *map(tuple, json.loads(robot.stdout.readline()))], key=lambda note: note[1])
    finally:
        robot.kill()
        robot.wait()
    return legs(spans[WARM_UP:], every)


def legs(spans: list[tuple[int, int]], every: list[tuple[str, int]]) -> dict[str, float]:
    """Return the median microseconds of each leg of calls, which have a start and an end."""
    durations: defaultdict[str, list[float]] = defaultdict(list)
    place = 0
    for start, end in spans:
        passed = {"end": end}
        while place < len(every) and every[place][1] <= end:
            name, at = every[place]
            if at >= start:
                passed.setdefault(name, at)
            place += 1
        before = start
        for _, what, station in LEGS:
            if station in passed:  # a message of another kind may have crossed the call
                durations[what].append((passed[station] - before) / 1000)
                before = passed[station]
        durations["whole call"].append((end - start) / 1000)
    return {what: statistics.median(times) for what, times in durations.items()}


def table() -> str:
    """Return the account of a reading and of a command in Markdown."""
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    observe(CONTROLLER)
    reading = measure(lambda lamp: lamp.get_value().get(), free_port())
    notes.clear()
    command = measure(lambda lamp: lamp.send_cmd("on").get(), free_port())
    lines = ["| end | what | get_value, µs | send_cmd, µs |", "|---|---|---|---|"]
    for end, what in [*((end, what) for end, what, _ in LEGS), ("", "whole call")]:
        lines.append(f"| {end} | {what} | {reading.get(what, 0):.0f} | {command.get(what, 0):.0f} |")
    return "\n".join(lines)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        serve()
    else:
        sys.stdout.write(table() + "\n")
