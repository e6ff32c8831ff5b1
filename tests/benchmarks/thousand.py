"""A thousand robots over the network: this checkout and an earlier one in turn, in one run.

Run as `python -m tests.benchmarks.thousand --before CHECKOUT [--page PAGE]`. Each checkout has two processes, one that
serves the robots and one that calls them, which runs this file with the modules of that checkout. They take what cores
there are.
"""

from __future__ import annotations

import argparse
import math
import statistics
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final

from eal_actors import EALError, Fleet, gather
from eal_actors.actors.robot_view import RobotState
from tests.benchmarks.network_host import fleet_of
from tests.benchmarks.page import machine, write_between
from tests.benchmarks.peers.peer import ROOT, Server, timed
from tests.net.links import free_port

BEGIN: Final = "<!-- written by python -m tests.benchmarks.thousand: begin -->"
ROBOTS: Final = 1000
ROUNDS: Final = 8
TIMEOUT_S: Final = 30.0
ONE, THREE = "one command to each, all answers", "a command to each and two readings, all answers"


def drive() -> None:
    """Make the calls that the lines of the standard input name, and print their seconds."""
    port = free_port()
    host = Server(["-m", "tests.benchmarks.network_host", str(ROBOTS), str(port)])
    try:
        with Fleet(fleet_of(ROBOTS, port)).connect(timeout_s=120) as fleet:
            while any(robot.state is not RobotState.READY for robot in fleet.values()):
                fleet.clock.sleep(0.1)
            lamps = [robot["Lamp"] for robot in fleet.values()]

            def one() -> None:
                gather([lamp.send_cmd("on", timeout_s=TIMEOUT_S) for lamp in lamps]).get()

            def three() -> None:
                commands = [lamp.send_cmd("on", timeout_s=TIMEOUT_S) for lamp in lamps]
                readings = [lamp.get_value(timeout_s=TIMEOUT_S) for lamp in 2 * lamps]
                gather(commands).get()
                gather(readings).get()

            actions: dict[str, Callable[[], None]] = {ONE: one, THREE: three}
            for line in sys.stdin:
                try:
                    sys.stdout.write(f"{timed(actions[line.strip()])}\n")
                except EALError:  # a command that became stale on a busy machine
                    sys.stdout.write("nan\n")
                sys.stdout.flush()
    finally:
        host.kill()


def measure(before: Path, rounds: int) -> dict[str, tuple[list[float], list[float]]]:
    """Return the seconds of each action, before and now, round by round."""
    from tests.benchmarks.versions import Driver

    drivers = [Driver(checkout, __file__) for checkout in (before, ROOT)]
    seconds: dict[str, tuple[list[float], list[float]]] = {ONE: ([], []), THREE: ([], [])}
    try:
        for is_warm in (False, *[True] * rounds):
            for what, columns in seconds.items():
                for driver, column in zip(drivers, columns, strict=True):
                    taken_s = driver.ask(what)
                    if is_warm and math.isfinite(taken_s):
                        column.append(taken_s)
    finally:
        for driver in drivers:
            driver.close()
    return seconds


def table(seconds: dict[str, tuple[list[float], list[float]]]) -> str:
    """Return the seconds in Markdown."""
    lines = ["| of 1,000 robots | before | now | now / before |", "|---|---|---|---|"]
    for what, (before, now) in seconds.items():
        old_s, new_s = statistics.median(before), statistics.median(now)
        lines.append(f"| {what} | {1000 * old_s:.0f} ms | {1000 * new_s:.0f} ms | {new_s / old_s:.2f} |")
    return "\n".join([*lines, "", f"{machine()}."])


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
    text = table(measure(options.before, options.rounds))
    sys.stdout.write(text + "\n")
    if options.page is not None:
        write_between(options.page, BEGIN, text)


if __name__ == "__main__":
    main()
