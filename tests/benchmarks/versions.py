"""Remote calls of this checkout beside those of an earlier one and raw TCP, in turn in one run on one core.

Run as `python -m tests.benchmarks.versions --before CHECKOUT [--page PAGE]`. Each checkout has a process of its own,
which runs this file with the modules of that checkout, and makes a block of calls on request.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from eal_actors import Fleet, gather
from tests.benchmarks.network_host import fleet_of
from tests.benchmarks.page import machine, write_between
from tests.benchmarks.peers.peer import CALLERS, ROBOTS, ROOT, Server, timed
from tests.benchmarks.peers.tcp import Tcp
from tests.net.links import free_port

BEGIN: Final = "<!-- written by python -m tests.benchmarks.versions: begin -->"
ROUNDS: Final = 15
BLOCKS: Final = {
    "one reading": ("get", 200),
    "one command": ("command", 200),
    f"a reading where {CALLERS} callers read at once": ("callers", 50),
    f"one command to {ROBOTS} robots of one process": ("fan_out", 5),
    "a frame of 921,600 bytes to a controller on the same machine": ("frame", 20),
    "the same over TCP": ("frame_over_tcp", 20),
}
"""The operations, and how often each is repeated in a round."""


def connected(stack: ExitStack, robots: int, *, is_shared: bool = True) -> Fleet:
    """Return a fleet whose robots another process serves."""
    port = free_port()
    stack.callback(Server(["-m", "tests.benchmarks.network_host", str(robots), str(port)]).kill)
    config = fleet_of(robots, port)
    return stack.enter_context(Fleet(replace(config, network=replace(config.network, shared_memory=is_shared))))


def median_s(action: Callable[[], object], count: int) -> float:
    """Return the median seconds of an action."""
    return statistics.median(timed(action) for _ in range(count))


def together_s(action: Callable[[], object], count: int) -> float:
    """Return the seconds of an action that several threads repeat at once."""

    def repeat() -> None:
        for _ in range(count):
            action()

    threads = [threading.Thread(target=repeat) for _ in range(CALLERS)]

    def run() -> None:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    return timed(run) / (CALLERS * count)


def drive() -> None:
    """Make a block of calls for each line of the standard input, and print the seconds of one."""
    with ExitStack() as stack:
        robot = connected(stack, 1)["bot1"]
        lamps = [other["Lamp"] for other in connected(stack, ROBOTS).values()]
        far_eye = connected(stack, 1, is_shared=False)["bot1"]["Eye"]

        def read() -> object:
            return robot["Lamp"].get_value().get()

        blocks: dict[str, Callable[[int], float]] = {
            "get": partial(median_s, read),
            "command": partial(median_s, lambda: robot["Lamp"].send_cmd("on").get()),
            "callers": partial(together_s, read),
            "fan_out": partial(median_s, lambda: gather([lamp.send_cmd("on") for lamp in lamps]).get()),
            "frame": partial(median_s, lambda: robot["Eye"].get_value().get()),
            "frame_over_tcp": partial(median_s, lambda: far_eye.get_value().get()),
        }
        for line in sys.stdin:
            what, count = line.split()
            sys.stdout.write(f"{blocks[what](int(count))}\n")
            sys.stdout.flush()


class Driver:
    """The process of a checkout.

    Args:
        checkout: its folder.
        program: file of this checkout that it runs.
    """

    def __init__(self, checkout: Path, program: str = __file__) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(Path(program).resolve()), "--drive"],
            cwd=checkout,
            env={**os.environ, "PYTHONPATH": str(checkout)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def block_s(self, what: str, count: int) -> float:
        """Return the seconds of an operation."""
        return self.ask(f"{what} {count}")

    def ask(self, line: str) -> float:
        """Return the answer to a line."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()
        return float(self._process.stdout.readline())

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def measure(before: Path, rounds: int) -> dict[str, list[list[float]]]:
    """Return the ratios to raw TCP of both checkouts, round by round."""
    with ExitStack() as stack:
        raw: Any = Tcp()
        stack.callback(raw.close)
        drivers = [Driver(checkout) for checkout in (before, ROOT)]
        for driver in drivers:
            stack.callback(driver.close)
        ratios: dict[str, list[list[float]]] = {title: [[], []] for title in BLOCKS}
        for is_warm in (False, *[True] * rounds):
            for title, (what, count) in BLOCKS.items():
                bare_s = getattr(raw, what.removesuffix("_over_tcp"))(count)
                for values, driver in zip(ratios[title], drivers, strict=True):
                    ratio = driver.block_s(what, count) / bare_s
                    if is_warm:
                        values.append(ratio)
        return ratios


def table(ratios: dict[str, list[list[float]]]) -> str:
    """Return the ratios in Markdown."""
    lines = ["| what, times raw TCP | before | now | best and worst round now |", "|---|---|---|---|"]
    for title, (before, now) in ratios.items():
        middles = f"{statistics.median(before):.1f} | {statistics.median(now):.1f}"
        lines.append(f"| {title} | {middles} | {min(now):.1f} to {max(now):.1f} |")
    return "\n".join([*lines, "", f"{machine()}; eclipse-zenoh {version('eclipse-zenoh')}."])


def main() -> None:
    """Measure, print the table, and write it into a page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--page", type=Path)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--drive", action="store_true")
    options = parser.parse_args()
    if options.drive:
        drive()
        return
    if options.before is None:
        parser.error("--before CHECKOUT is missing")
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    text = table(measure(options.before, options.rounds))
    sys.stdout.write(text + "\n")
    if options.page is not None:
        write_between(options.page, BEGIN, text)


if __name__ == "__main__":
    main()
