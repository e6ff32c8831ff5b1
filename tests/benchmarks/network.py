"""Robots of another process over zenoh on loopback, beside the bare engine in the same run."""

from __future__ import annotations

import math
import os
import signal
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from eal_actors import Fleet, gather
from eal_actors.actors.robot_view import RobotState
from eal_actors.kernel.clock import REAL_TIME
from tests.benchmarks.crowd import resident_bytes
from tests.benchmarks.network_host import ENVELOPE, VIEW, bare_config, fleet_of
from tests.benchmarks.result import Result
from tests.net.links import free_port

ROOT = Path(__file__).parents[2]
STREAM_HZ = 5.0


def cpus() -> list[int]:
    """Return the CPU of the controller and that of the robots; nothing where there is one alone."""
    return sorted(os.sched_getaffinity(0))[:2] if len(os.sched_getaffinity(0)) > 1 else []


CPUS = cpus()
PLACES = f", CPU {CPUS[0]} to CPU {CPUS[1]}" if CPUS else ""


@contextmanager
def hosted(robots: int) -> Iterator[tuple[Fleet, Any, subprocess.Popen[str]]]:
    """Serve robots in a process of their own; give their fleet, connected, and a bare session to it."""
    import zenoh

    port, bare_port = free_port(), free_port()
    host = subprocess.Popen(
        [sys.executable, "-m", "tests.benchmarks.network_host", *map(str, [robots, port, bare_port, *CPUS[1:]])],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,  # hundreds of stops, each in the log
        text=True,
    )
    assert host.stdout is not None
    try:
        if host.stdout.readline() != "up\n":
            raise AssertionError("the host did not come up")
        with zenoh.open(bare_config(connect=bare_port)) as session, Fleet(fleet_of(robots, port)) as fleet:
            yield fleet, session, host
    finally:
        host.kill()
        host.communicate()


class Countdown:
    """Tells when something has happened so many times."""

    def __init__(self, times: int) -> None:
        self._left = times
        self._lock = threading.Lock()
        self._done = threading.Event()

    def count(self) -> None:
        with self._lock:
            self._left -= 1
            if self._left == 0:
                self._done.set()

    def wait(self) -> None:
        if not self._done.wait(20):
            raise AssertionError("the bare engine did not answer")


def bare_round(session: Any, keys: list[str], payload: bytes = b"") -> float:
    """Return how long the bare engine takes to ask all the keys at once, and to hear all the answers.

    It returns once the engine has nothing left to do for them, lest that be counted as ours.
    """
    import zenoh

    heard, over = Countdown(len(keys)), Countdown(len(keys))

    def hear(reply: Any) -> None:
        reply.ok.payload.to_bytes()
        heard.count()

    start = time.perf_counter()
    for key in keys:
        session.get(
            key,
            zenoh.handlers.Callback(hear, over.count, indirect=False),
            consolidation=zenoh.ConsolidationMode.NONE,
            payload=payload or None,
            attachment=ENVELOPE,
            express=True,
            timeout=10.0,
        )
    heard.wait()
    taken_s = time.perf_counter() - start
    over.wait()
    return taken_s


def timed(action: Callable[[], object]) -> float:
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def in_turns(
    turns: int, ours: Callable[[], float], bare: Callable[[], float], calls: int = 1
) -> tuple[float, float, float]:
    """Return the median of ours, of the bare engine, and of their ratio, measured turn by turn.

    A turn is so many calls, one after another, lest each find the caches full of the other's.
    """
    mine, theirs = [], []
    for _ in range(turns):
        mine.append(statistics.median(ours() for _ in range(calls)))
        theirs.append(statistics.median(bare() for _ in range(calls)))
    ratio = statistics.median(our / their for our, their in zip(mine, theirs, strict=True))
    return statistics.median(mine), statistics.median(theirs), ratio


def one_robot() -> list[Result]:
    """Small readings and whole frames."""
    with hosted(1) as (fleet, session, _):
        lamp, eye = fleet["bot1"]["Lamp"], fleet["bot1"]["Eye"]
        get_s, bare_s, ratio = in_turns(
            60, lambda: timed(lambda: lamp.get_value().get()), lambda: bare_round(session, ["bare/0/value"]), calls=50
        )
        frame_s, bare_frame_s, frame_ratio = in_turns(
            20, lambda: timed(lambda: eye.get_value().get()), lambda: bare_round(session, ["bare/0/frame"]), calls=10
        )
    what = f"remote get_value, p50{PLACES}"
    rates = f"{1 / frame_s:.0f} frames/s", f"bare zenoh: {1 / bare_frame_s:.0f} frames/s"
    return [
        Result(what, f"{get_s * 1e6:.0f} µs", f"bare zenoh get: {bare_s * 1e6:.0f} µs", ratio, 1.6),
        Result("921,600-byte frame by request", *rates, 1 / frame_ratio, 0.8, at_least=True),
    ]


def hundred_robots() -> list[Result]:
    """One command to all, and a stop while each streams frames; what a dead and what a frozen process cost."""
    with hosted(100) as (fleet, session, host):
        lamps = [robot["Lamp"] for robot in fleet.values()]
        keys = [f"bare/{number}/command" for number in range(100)]
        ours_s, bare_s, ratio = in_turns(
            40,
            lambda: timed(lambda: gather([lamp.send_cmd("on") for lamp in lamps]).get()),
            lambda: bare_round(session, keys),
        )
        stop_s, frames_hz = _stop_while_streaming(fleet)
        host.send_signal(signal.SIGSTOP)
        frozen_s = timed(lambda: _wait_for(fleet, RobotState.LOST))
        host.send_signal(signal.SIGCONT)
        _wait_for(fleet, RobotState.READY)
        host.kill()
        lost_s = timed(lambda: _wait_for(fleet, RobotState.LOST))
        lease_s = fleet.config.network.lease_s
    frames = f"beside {frames_hz:.0f} frames/s of {VIEW.nbytes:,} bytes"
    commands = f"{ours_s * 1e3:.1f} ms", f"bare zenoh: {bare_s * 1e3:.1f} ms"
    return [
        Result("one command to 100 robots and all answers", *commands, ratio, 1.6),
        Result("stop confirmed by 100 robots", f"{stop_s * 1e3:.0f} ms", frames, stop_s * 1e3, 50, "ms"),
        Result("kill of the robots' process seen as lost", f"{lost_s:.2f} s", "", lost_s, 0.5, "s"),
        Result(
            "freeze of that process seen as lost",
            f"{frozen_s:.2f} s",
            f"lease: {lease_s:g} s",
            frozen_s,
            lease_s + 0.5,
            "s",
        ),
    ]


def _stop_while_streaming(fleet: Fleet) -> tuple[float, float]:
    """Return how long a stop of all robots takes, each moving and streaming, and how many frames come in a second."""
    with ExitStack() as stack:
        streams = [stack.enter_context(robot["Eye"].stream(STREAM_HZ)) for robot in fleet.values()]
        start = time.perf_counter()
        times = []
        for _ in range(5):
            flashing = [robot["Lamp"].send_cmd("flash") for robot in fleet.values()]
            for stream in streams * 3:  # each frame is another one
                next(stream)
            times.append(timed(lambda: fleet.stop("bench").get()))
            if any(future.exception() is None for future in flashing):
                raise AssertionError("a robot went on flashing")
            fleet.resume().get()
        frames = 15 * len(streams) + sum(stream.skipped for stream in streams)
        return statistics.median(times), frames / (time.perf_counter() - start)


def _wait_for(fleet: Fleet, state: RobotState) -> None:
    while any(robot.state is not state for robot in fleet.values()):
        REAL_TIME.sleep(0.002)


def thousand_robots() -> list[Result]:
    """Connecting, commanding, memory."""
    port_fleet = hosted(1000)
    before = resident_bytes()
    with port_fleet as (fleet, _, _):
        connect_s = _reconnect(fleet)
        weight = (resident_bytes() - before) / 1000
        lamps = [robot["Lamp"] for robot in fleet.values()]
        refused = 0

        def command() -> None:
            nonlocal refused
            answers = gather([lamp.send_cmd("on") for lamp in lamps], return_exceptions=True).get()
            refused += sum(answer != 1 for answer in answers)

        command_s = statistics.median(timed(command) for _ in range(5))
    told = f"{command_s:.2f} s" + (f", {refused / 5000:.0%} refused as stale" if refused else "")
    return [
        Result("1,000 robots on one controller: connect", f"{connect_s:.1f} s", "", connect_s, 10, "s"),
        Result("one command to 1,000 robots and all answers", told, "", math.inf if refused else command_s, 0.5, "s"),
        Result("controller's memory for each of them", f"{weight / 1e3:.0f} kB", "", weight / 1e3, 300, "kB"),
    ]


def _reconnect(fleet: Fleet) -> float:
    fleet.close()
    return timed(fleet.connect)


def run() -> list[Result]:
    """Measure with the controller on one CPU and the robots' process on another."""
    os.sched_setaffinity(0, CPUS[:1] or os.sched_getaffinity(0))
    return [*one_robot(), *hundred_robots(), *thousand_robots()]
