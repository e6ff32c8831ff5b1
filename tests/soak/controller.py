"""A controller process that commands robots at random and records its requests and answers.

Run as `python -m tests.soak.controller FLEET JOURNAL SEED FIRST_NUMBER HOME...`; it ends with its standard input, after
every call has an outcome. HOME are the robots that it mostly commands.
"""

from __future__ import annotations

import os
import random
import sys
import threading
import time
from functools import partial
from pathlib import Path
from typing import Any

from eal_actors import Fleet
from eal_actors.actors.future import Future
from eal_actors.actors.robot_view import RobotState
from eal_actors.kernel.clock import REAL_TIME, acquire_alert, new_waiter
from eal_actors.kernel.errors import EALError
from eal_actors.managers.config import EALConfigManager

TIMEOUTS_S = (0.5, 2.0, 6.0)
PAUSE_S = 0.08
"""Seconds between two actions, on average."""
FLOOD = 400
SETTLE_S = 30.0


class Journal:
    """Appends whole lines to a file: the machine's monotonic time, and what happens. Thread: any."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)

    def write(self, *words: object) -> None:
        now_s = time.clock_gettime(time.CLOCK_MONOTONIC)
        os.write(self._file, f"{now_s:.6f} {' '.join(map(str, words))}\n".encode())


class Restless:
    """Commands the robots of one fleet.

    Args:
        fleet: the fleet file.
        journal: where to write.
        seed: of what it does.
        first: the number of its first command; each has another.
        home: the robots that it mostly commands.
    """

    def __init__(self, fleet: Path, journal: Journal, seed: int, first: int, home: list[str]) -> None:
        self._config = EALConfigManager.load(fleet).fleet
        self._journal = journal
        self._random = random.Random(seed)  # noqa: S311  # a test
        self._number = first
        self._home = home
        self._lock = threading.Lock()
        self._open = 0
        self._settled = threading.Condition(self._lock)

    def run(self, ends: threading.Lock) -> None:
        """Go on until the waiter is released."""
        while True:
            with Fleet(self._config) as fleet:
                forget = [robot.on_state(partial(self._note_state, robot.name)) for robot in fleet.values()]
                is_over = self._command(fleet, ends)
                self._settle()
                for end in forget:
                    end()
                self._journal.write("leaving")
            self._journal.write("left")
            if is_over:
                return

    def _command(self, fleet: Fleet, ends: threading.Lock) -> bool:
        """Command robots until it is time to connect anew, or to end; return whether to end."""
        while not acquire_alert(ends, self._random.expovariate(1 / PAUSE_S)):
            act = self._random.choices(
                (self._drive, self._mark, self._read, self._halt, self._flood, None), (40, 30, 20, 8, 0.7, 0.4)
            )[0]
            if act is None:
                return False
            name = self._random.choice(self._home if self._random.random() < 0.9 else list(fleet))
            try:
                act(fleet, name)
            except EALError as error:  # the robot was never reached, so that it has no resources
                self._journal.write("unknown", name, error.code)
        return True

    def _drive(self, fleet: Fleet, name: str) -> None:
        self._send(fleet, name, "Wheels", "drive", self._random.choice(TIMEOUTS_S))

    def _mark(self, fleet: Fleet, name: str) -> None:
        self._send(fleet, name, "Pen", "mark", self._random.choice(TIMEOUTS_S))

    def _flood(self, fleet: Fleet, name: str) -> None:
        for _ in range(FLOOD):
            self._send(fleet, name, "Pen", "mark", TIMEOUTS_S[-1])

    def _send(self, fleet: Fleet, name: str, resource: str, verb: str, timeout_s: float) -> None:
        handle = fleet[name][resource]
        number, self._number = self._number, self._number + 1
        self._journal.write("sent", number, name, resource, timeout_s)
        self._follow(handle.send_cmd(f"{verb}{number}", timeout_s=timeout_s), number, "")

    def _read(self, fleet: Fleet, name: str) -> None:
        self._follow(fleet[name]["Gauge"].get_value(timeout_s=2.0), 0, "read")

    def _halt(self, fleet: Fleet, name: str) -> None:
        self._follow(fleet[name]["Wheels"].halt(timeout_s=2.0), 0, "halt")

    def _follow(self, call: Future[Any], number: int, what: str) -> None:
        with self._lock:
            self._open += 1
        call.add_done_callback(partial(self._note_outcome, number, what))

    def _note_outcome(self, number: int, what: str, call: Future[Any]) -> None:
        error = call.exception()
        code = "ok" if error is None else error.code if isinstance(error, EALError) else repr(error)
        self._journal.write(*((what, code) if what else ("done", number, code)))
        with self._settled:
            self._open -= 1
            self._settled.notify_all()

    def _note_state(self, robot: str, state: RobotState) -> None:
        self._journal.write("state", robot, state.value)

    def _settle(self) -> None:
        """Wait for every outcome: each call has a deadline, so that all come."""
        with self._settled:
            self._settled.wait_for(lambda: self._open == 0, SETTLE_S)
            if self._open:
                self._journal.write("unsettled", self._open)


def main() -> None:
    """Command until the standard input ends."""
    fleet, journal, seed, first, *home = sys.argv[1:]
    ends = new_waiter()

    def listen() -> None:
        sys.stdin.read()
        REAL_TIME.wake(ends)

    threading.Thread(target=listen, daemon=True).start()
    notes = Journal(Path(journal))
    notes.write("up", os.getpid())
    Restless(Path(fleet), notes, int(seed), int(first), home).run(ends)


if __name__ == "__main__":
    main()
