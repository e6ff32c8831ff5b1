"""The share of the interpreter and of the engine's threads in a remote call, and why it costs so much.

Run as `python -m tests.benchmarks.interpreter [--page PAGE]`. It counts the instructions of the interpreter that a
reading and a command run at both ends, in this project's modules; divides the time that they take between two messages
(tests/benchmarks/account.py) by their number; and does the same for the coding of messages in a loop, where the
processor's caches know the interpreter. It compares the processor's time of the engine's threads with that in the least
program (tests/benchmarks/least.py), and two processes with one. One core for all.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import threading
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any, Final

from eal_actors import Fleet
from eal_actors.device.data import EALData
from eal_actors.wire.engine_setup import share_threads
from eal_actors.wire.format.messages import NO_PROOF, decode_call, decode_reply, encode_fields, encode_value
from tests.benchmarks import account, floor
from tests.benchmarks.network_host import fleet_of, serving
from tests.benchmarks.page import machine, publish
from tests.benchmarks.peers.peer import Server, timed
from tests.net.links import free_port

BEGIN: Final = "<!-- written by python -m tests.benchmarks.interpreter: begin -->"
CALLS: Final = 300
_PACKAGE: Final = os.sep + "eal_actors" + os.sep
_WATCHES: Final = ("own_sockets.py", "link_watch.py", "accept_guard.py")
"""Modules that run by themselves, beside the calls."""
_PYTHON: Final = (
    "handle, checks, header",
    "decode, admit, mailbox",
    "method, outcome, encode, outbox",
    "decode, find the call, set the outcome",
)
"""The legs of the account in which the interpreter runs."""


class Counts:
    """Counts of the instructions and functions of this process's threads; threads must begin after `watch`."""

    def __init__(self) -> None:
        self.instructions = Counter[str]()
        self.functions = Counter[str]()
        self.is_on = False

    def watch(self) -> None:
        """Follow this thread and all that begin from now on."""
        threading.settrace(self._enter)
        sys.settrace(self._enter)

    def _enter(self, frame: FrameType, _: str, __: object) -> Callable[..., Any] | None:
        name = frame.f_code.co_filename
        if _PACKAGE not in name or name.endswith(_WATCHES):
            return None
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        if self.is_on:
            self.functions[name] += 1
        return self._step

    def _step(self, frame: FrameType, event: str, _: object) -> Callable[..., Any]:
        if self.is_on and event == "opcode":
            self.instructions[frame.f_code.co_filename] += 1
        return self._step

    def totals(self) -> list[int]:
        """Return how many instructions ran, and how many functions were called."""
        return [self.instructions.total(), self.functions.total()]


def serve_counting() -> None:
    """Serve a robot; a line of the standard input begins the count, its end prints it."""
    counts = Counts()
    counts.watch()
    with serving(1, int(sys.argv[2])):
        sys.stdout.write("up\n")
        sys.stdout.flush()
        sys.stdin.readline()
        counts.is_on = True
        sys.stdin.read()
        counts.is_on = False
        sys.settrace(None)
        sys.stdout.write(json.dumps(counts.totals()) + "\n")
        sys.stdout.flush()


def count(call: Callable[[Any], object]) -> list[float]:
    """Return instructions and functions of a call: at the controller, then at the robot."""
    port, counts = free_port(), Counts()
    robot = account.RobotProcess("tests.benchmarks.interpreter", str(port))
    counts.watch()
    try:
        with Fleet(fleet_of(1, port)) as fleet:
            lamp = fleet["bot1"]["Lamp"]
            for _ in range(CALLS // 3):
                call(lamp)
            robot.begin()
            counts.is_on = True
            for _ in range(CALLS):
                call(lamp)
            counts.is_on = False
        there = robot.end()
    finally:
        robot.kill()
        sys.settrace(None)
        threading.settrace(None)
    return [number / CALLS for number in (*counts.totals(), *there)]


def code_once() -> None:
    """Encode and decode a reading and its reply."""
    decode_call(*encode_fields("0" * 32, 1, 1, 5.0, 5.0, None, (), NO_PROOF, None))
    value = EALData.of(1.0, stamp_s=0.0)
    decode_reply(encode_value(1, value, 0.0, "0123abcd", 1.0), value.payload)


def loop_ns() -> float:
    """Return the nanoseconds of an instruction in a loop."""
    counts = Counts()
    counts.watch()
    counts.is_on = True
    code_once()
    counts.is_on = False
    sys.settrace(None)
    threading.settrace(None)
    for _ in range(1000):
        code_once()
    return 1e9 * statistics.median(timed(code_once) for _ in range(5000)) / counts.totals()[0]


def thread_ns(process: int) -> Counter[str]:
    """Return the processor's time of a process's threads by their names."""
    times = Counter[str]()
    for task in Path(f"/proc/{process}/task").iterdir():
        times[(task / "comm").read_text().strip()] += int((task / "schedstat").read_text().split()[0])
    return times


def engine_us(call: Callable[[], object], process: int) -> list[float]:
    """Return the microseconds of the processor that a message takes of the engine's receiving and sending threads."""
    for _ in range(CALLS):
        call()
    before = thread_ns(process)
    for _ in range(CALLS):
        call()
    spent = thread_ns(process) - before
    return [sum(ns for name, ns in spent.items() if name.startswith(kind)) / CALLS / 1000 for kind in ("rx", "tx")]


def compare() -> tuple[list[float], list[float], float, float]:
    """Return the engine's times here and in the least program, and a reading's time by two processes and by one."""
    with ExitStack() as stack:
        port = free_port()
        host = Server(["-m", "tests.benchmarks.network_host", "1", str(port)])
        stack.callback(host.kill)
        fleet = fleet_of(1, port)
        lamp = stack.enter_context(Fleet(fleet))["bot1"]["Lamp"]
        over_engine = replace(fleet, network=replace(fleet.network, shared_memory=False))
        far = stack.enter_context(Fleet(over_engine))["bot1"]["Lamp"]
        least = Server(["-m", "tests.benchmarks.floor", "--serve", floor.LEAST, str(least_port := free_port())])
        stack.callback(least.kill)
        caller = floor.Caller(floor.LEAST, least_port)
        stack.callback(caller.close)
        caller.find()
        near_port = free_port()
        stack.enter_context(serving(1, near_port))
        near = stack.enter_context(Fleet(fleet_of(1, near_port)))["bot1"]["Lamp"]
        ours = engine_us(lambda: far.get_value().get(), host.pid)
        theirs = engine_us(caller.get, least.pid)
        two = 1e6 * statistics.median(timed(lambda: lamp.get_value().get()) for _ in range(5 * CALLS))
        one = 1e6 * statistics.median(timed(lambda: near.get_value().get()) for _ in range(5 * CALLS))
        return ours, theirs, two, one


def table() -> str:
    """Return the figures in Markdown."""
    calls: tuple[Callable[[Any], object], ...] = (
        lambda lamp: lamp.get_value().get(),
        lambda lamp: lamp.send_cmd("on").get(),
    )
    (rx, tx), (least_rx, least_tx), two_us, one_us = compare()  # first: what follows slows this process down
    in_loop_ns = loop_ns()
    counted = [count(call) for call in calls]
    account.observe(account.CONTROLLER)
    legs = [account.measure(call, free_port()) for call in calls]
    spent_us = [sum(times[leg] for leg in _PYTHON) for times in legs]
    rows = [
        ["instructions at the controller", *(f"{numbers[0]:.0f}" for numbers in counted)],
        ["instructions at the robot", *(f"{numbers[2]:.0f}" for numbers in counted)],
        ["functions at both ends", *(f"{numbers[1] + numbers[3]:.0f}" for numbers in counted)],
        ["their time between messages", *(f"{time_us:.0f} µs" for time_us in spent_us)],
        [
            "time of one instruction there",
            *(f"{1000 * us / (n[0] + n[2]):.0f} ns" for us, n in zip(spent_us, counted, strict=True)),
        ],
        ["time of one in a loop (coding of messages)", f"{in_loop_ns:.0f} ns", ""],
        ["the engine's threads that receive and send, a message over TCP", f"{rx:.0f} and {tx:.0f} µs", ""],
        ["the same in the least program", f"{least_rx:.0f} and {least_tx:.0f} µs", ""],
        ["a reading, the ends in two processes", f"{two_us:.0f} µs", ""],
        ["a reading, both ends in one process", f"{one_us:.0f} µs", ""],
    ]
    head = "| what | get_value | send_cmd |\n|---|---|---|"
    return "\n".join([head, *(f"| {' | '.join(row)} |" for row in rows), "", f"{machine()}."])


def main() -> None:
    """Measure, print the table, and write it into a page."""
    if sys.argv[1:2] == ["--serve"]:
        serve_counting()
        return
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", type=Path)
    options = parser.parse_args()
    share_threads()
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    publish(table(), options.page, BEGIN)


if __name__ == "__main__":
    main()
