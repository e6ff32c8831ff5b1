"""Where the time of a remote call goes: microseconds between the stations of its path, at both ends.

Run as `python -m tests.benchmarks.account [--page PAGE]`: it prints a table in Markdown and writes it into a page, over
the engine's link and over a local link. Each station is a method that the path enters or leaves; a wrapper notes the
time of the system's clock there, which both processes share. One core; the median of the calls counts. A wrapper adds
about half a microsecond.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from eal_actors import Fleet
from eal_actors.actors.future import Future
from eal_actors.actors.inbox import Inbox
from eal_actors.actors.resource_actor import ResourceActor
from eal_actors.wire.local_link import LocalLink
from eal_actors.wire.rpc.client.controller import Controller
from eal_actors.wire.rpc.server.host import RobotHost
from eal_actors.wire.transport import Transport
from tests.benchmarks import network_host
from tests.benchmarks.network_host import fleet_of
from tests.benchmarks.page import machine, publish
from tests.net.links import free_port

ROOT: Final = Path(__file__).parents[2]
BEGIN: Final = "<!-- written by python -m tests.benchmarks.account: begin -->"
WHOLE: Final = "whole call"
CALLS: Final = 400
WARM_UP: Final = 100

Station = tuple[str, type, str, bool]
"""Name, class, method, and whether its entry (True) or its exit counts."""

CONTROLLER: Final[tuple[Station, ...]] = (
    ("the call is encoded", Transport, "put", True),
    ("the call is sent", Transport, "put", False),
    ("the call is encoded", LocalLink, "send", True),
    ("the call is sent", LocalLink, "send", False),
    ("the answer is received", Controller, "_on_reply", True),
    ("the caller is woken", Future, "settle", False),
)
ROBOT: Final[tuple[Station, ...]] = (
    ("the call is received", RobotHost, "_receive", True),
    ("it is in the mailbox", Inbox, "put", False),
    ("the resource begins", ResourceActor, "_execute", True),
    ("the answer is encoded", Transport, "put", True),
    ("the answer is sent", Transport, "put", False),
    ("the answer is encoded", LocalLink, "send", True),
    ("the answer is sent", LocalLink, "send", False),
)
LEGS: Final = (
    ("controller", "handle, checks, header", "the call is encoded"),
    ("controller", "the link takes the call", "the call is sent"),
    ("link", "to the robot, reader wakes", "the call is received"),
    ("robot", "decode, admit, mailbox", "it is in the mailbox"),
    ("robot", "the resource's thread wakes", "the resource begins"),
    ("robot", "method, outcome, encode, outbox", "the answer is encoded"),
    ("robot", "the link takes the answer", "the answer is sent"),
    ("link", "to the controller, reader wakes", "the answer is received"),
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


class RobotProcess:
    """A process of a benchmark's module that serves a robot, and prints one line of JSON when its input ends."""

    def __init__(self, module: str, *arguments: str) -> None:
        command = [sys.executable, "-m", module, "--serve", *arguments]
        self.process = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "up\n"

    def begin(self) -> None:
        """Send an empty line."""
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()

    def end(self) -> Any:
        """Return what it prints at the end."""
        return json.loads(self.process.communicate()[0])

    def kill(self) -> None:
        """Kill it, if it has not ended."""
        self.process.kill()
        self.process.wait()


def measure(call: Callable[[Any], object], port: int, *, is_local: bool = True) -> dict[str, float]:
    """Return the median microseconds of each leg, over a local link or the engine's."""
    notes.clear()
    robot = RobotProcess("tests.benchmarks.account", "1", str(port))
    config = fleet_of(1, port)
    try:
        spans: list[tuple[int, int]] = []
        with Fleet(replace(config, network=replace(config.network, shared_memory=is_local))) as fleet:
            lamp = fleet["bot1"]["Lamp"]
            for _ in range(WARM_UP + CALLS):
                start = time.monotonic_ns()
                call(lamp)
                spans.append((start, time.monotonic_ns()))
        every = sorted([*notes, *map(tuple, robot.end())], key=lambda note: note[1])
    finally:
        robot.kill()
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
        durations[WHOLE].append((end - start) / 1000)
    return {what: statistics.median(times) for what, times in durations.items()}


def table() -> str:
    """Return the account in Markdown."""
    observe(CONTROLLER)
    calls: tuple[Callable[[Any], object], ...] = (
        lambda lamp: lamp.get_value().get(),
        lambda lamp: lamp.send_cmd("on").get(),
    )
    columns = [measure(call, free_port(), is_local=is_local) for call in calls for is_local in (False, True)]
    lines = [
        "| end | what | get_value over the engine | local link | send_cmd over the engine | local link |",
        "|---|---|---|---|---|---|",
    ]
    for end, what in [*((end, what) for end, what, _ in LEGS), ("", WHOLE)]:
        lines.append(f"| {end} | {what} | {' | '.join(f'{times.get(what, 0):.0f}' for times in columns)} |")
    return "\n".join([*lines, "", f"{machine()}; eclipse-zenoh {version('eclipse-zenoh')}."])


def main() -> None:
    """Print the account, and write it into a page if one is named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", type=Path)
    parser.add_argument("--serve", nargs=2)
    options = parser.parse_args()
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    if options.serve:
        sys.argv[1:] = options.serve
        serve()
    else:
        publish(table(), options.page, BEGIN)


if __name__ == "__main__":
    main()
