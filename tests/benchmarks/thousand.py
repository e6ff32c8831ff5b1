"""A thousand robots over the network: this checkout and an earlier one in turn, in one run.

Run as `python -m tests.benchmarks.thousand --before CHECKOUT [--page PAGE]`. Each checkout has two processes, one that
serves the robots and one that calls them, which runs this file with the modules of that checkout. They take what cores
there are.
"""

from __future__ import annotations

import math
import statistics
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

from eal_actors import EALError, Fleet, gather
from eal_actors.actors.robot_view import RobotState
from tests.benchmarks.network_host import fleet_of
from tests.benchmarks.page import machine
from tests.benchmarks.peers.peer import Server, timed
from tests.net.links import free_port

if TYPE_CHECKING:
    from tests.benchmarks.driver import Driver

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


def measure(drivers: Sequence[Driver], rounds: int) -> dict[str, tuple[list[float], list[float]]]:
    """Return the seconds of each action, before and now, round by round."""
    seconds: dict[str, tuple[list[float], list[float]]] = {ONE: ([], []), THREE: ([], [])}
    for is_warm in (False, *[True] * rounds):
        for what, columns in seconds.items():
            for driver, column in zip(drivers, columns, strict=True):
                taken_s = driver.ask(what)
                if is_warm and math.isfinite(taken_s):
                    column.append(taken_s)
    return seconds


def table(drivers: Sequence[Driver], rounds: int) -> str:
    """Return the seconds in Markdown."""
    lines = ["| of 1,000 robots | before | now | now / before |", "|---|---|---|---|"]
    for what, (before, now) in measure(drivers, rounds).items():
        old_s, new_s = statistics.median(before), statistics.median(now)
        lines.append(f"| {what} | {1000 * old_s:.0f} ms | {1000 * new_s:.0f} ms | {new_s / old_s:.2f} |")
    return "\n".join([*lines, "", f"{machine()}."])


if __name__ == "__main__":
    if "--drive" in sys.argv:
        drive()
    else:
        from tests.benchmarks.driver import compare  # an earlier checkout, whose modules `drive` has, may lack it

        compare(sys.modules[__name__], table, rounds=ROUNDS, one_core=False)
