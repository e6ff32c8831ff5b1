"""Where the time of a remote call goes: microseconds between the stations of its path, at both ends.

Run as `python -m tests.benchmarks.account [--page PAGE] [--before CHECKOUT]`: it prints a table in Markdown, and writes
it into a page, beside the figures of an earlier checkout if one is given. Both are measured twice, in turn. Each
station is a method that the path enters or leaves; a wrapper notes the time of the system's clock there, which both
processes share. One core; the median of the calls counts. A wrapper adds about half a microsecond.
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
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from eal_actors import Fleet
from eal_actors.actors.future import Future
from eal_actors.actors.inbox import Inbox
from eal_actors.actors.resource_actor import ResourceActor
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


def measure(call: Callable[[Any], object], port: int) -> dict[str, float]:
    """Return the median microseconds of each leg."""
    robot = RobotProcess("tests.benchmarks.account", "1", str(port))
    try:
        spans: list[tuple[int, int]] = []
        with Fleet(fleet_of(1, port)) as fleet:
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


def account() -> dict[str, list[float]]:
    """Return the median microseconds of each leg of a reading and of a command."""
    observe(CONTROLLER)
    reading = measure(lambda lamp: lamp.get_value().get(), free_port())
    notes.clear()
    command = measure(lambda lamp: lamp.send_cmd("on").get(), free_port())
    return {what: [reading.get(what, 0), command.get(what, 0)] for what in (*(leg for _, leg, _ in LEGS), WHOLE)}


def account_of(checkout: Path) -> dict[str, list[float]]:
    """Return the account of a checkout, measured by its own module: the rows of the table that it prints."""
    environment = {**os.environ, "PYTHONPATH": str(checkout)}
    command = [sys.executable, "-m", "tests.benchmarks.account"]
    printed = subprocess.run(command, cwd=checkout, env=environment, check=True, capture_output=True, text=True).stdout
    rows = [[cell.strip() for cell in line.strip("| ").split("|")] for line in printed.splitlines()]
    return {row[-3]: [float(row[-2]), float(row[-1])] for row in rows if row[-1].isdecimal()}


def table(before: Path | None) -> str:
    """Return the account in Markdown, beside that of an earlier checkout."""
    checkouts = [ROOT] if before is None else [before, ROOT]
    accounts = [[account_of(checkout) for checkout in checkouts] for _ in range(2 if before else 1)]
    titles = ["get_value", "send_cmd"] if before is None else ["get_value before", "now", "send_cmd before", "now"]
    lines = [f"| end | what | {' | '.join(titles)} |", "|---" * (2 + len(titles)) + "|"]
    for end, what in [*((end, what) for end, what, _ in LEGS), ("", WHOLE)]:
        kinds = [
            [statistics.mean(run[place][what][kind] for run in accounts) for place in range(len(checkouts))]
            for kind in (0, 1)
        ]
        lines.append(f"| {end} | {what} | {' | '.join(f'{time_us:.0f}' for kind in kinds for time_us in kind)} |")
    return "\n".join([*lines, "", f"{machine()}; eclipse-zenoh {version('eclipse-zenoh')}."])


def main() -> None:
    """Print the account of this checkout; write it into a page if one is named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", type=Path)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--serve", nargs=2)
    options = parser.parse_args()
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    if options.serve:
        sys.argv[1:] = options.serve
        serve()
    elif options.page is None and options.before is None:
        lines = [f"| {what} | {reading:.0f} | {command:.0f} |" for what, (reading, command) in account().items()]
        sys.stdout.write("\n".join(["| what | get_value, µs | send_cmd, µs |", "|---|---|---|", *lines]) + "\n")
    else:
        publish(table(options.before), options.page, BEGIN)


if __name__ == "__main__":
    main()
