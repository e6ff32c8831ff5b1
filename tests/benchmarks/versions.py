"""Remote calls of this checkout beside those of an earlier one and raw TCP, in turn in one run on one core.

Run as `python -m tests.benchmarks.versions --before CHECKOUT [--page PAGE]`. Each checkout has a process of its own,
which runs this file with the modules of that checkout, and makes a block of calls on request.
"""

from __future__ import annotations

import statistics
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Final

from eal_actors import Fleet, gather
from tests.benchmarks.network_host import fleet_of
from tests.benchmarks.page import machine
from tests.benchmarks.peers.peer import CALLERS, ROBOTS, Server, timed
from tests.benchmarks.peers.tcp import Tcp
from tests.net.links import free_port

if TYPE_CHECKING:
    from tests.benchmarks.driver import Driver

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


def measure(drivers: Sequence[Driver], rounds: int) -> dict[str, list[list[float]]]:
    """Return the ratios to raw TCP of both checkouts, round by round."""
    with ExitStack() as stack:
        raw: Any = Tcp()
        stack.callback(raw.close)
        ratios: dict[str, list[list[float]]] = {title: [[], []] for title in BLOCKS}
        for is_warm in (False, *[True] * rounds):
            for title, (what, count) in BLOCKS.items():
                bare_s = getattr(raw, what.removesuffix("_over_tcp"))(count)
                for values, driver in zip(ratios[title], drivers, strict=True):
                    ratio = driver.ask(f"{what} {count}") / bare_s
                    if is_warm:
                        values.append(ratio)
        return ratios


def table(drivers: Sequence[Driver], rounds: int) -> str:
    """Return the ratios in Markdown."""
    lines = ["| what, times raw TCP | before | now | best and worst round now |", "|---|---|---|---|"]
    for title, (before, now) in measure(drivers, rounds).items():
        middles = f"{statistics.median(before):.1f} | {statistics.median(now):.1f}"
        lines.append(f"| {title} | {middles} | {min(now):.1f} to {max(now):.1f} |")
    return "\n".join([*lines, "", f"{machine()}; eclipse-zenoh {version('eclipse-zenoh')}."])


if __name__ == "__main__":
    if "--drive" in sys.argv:
        drive()
    else:
        from tests.benchmarks.driver import compare  # an earlier checkout, whose modules `drive` has, may lack it

        compare(sys.modules[__name__], table, rounds=ROUNDS, one_core=True)
