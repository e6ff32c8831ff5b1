"""The least cost of a remote call: one step after another from raw TCP to this project's call, in one run.

Run as `python -m tests.benchmarks.floor [--page PAGE]`. Every step uses the engine as the project does: its threads,
keys and publishers. Each step adds what the next one needs: two publications of the engine; a thread for the resource
and one for the caller, as actors and futures need them; the packed fields of a call and its reply, numbered, so that
several callers share a link; the least program that keeps the promises (tests/benchmarks/least.py): admission,
deadlines, leases, receipts, times, and a bounded mailbox. The last row's distance to that is what the rest of the
project costs. All processes share one core, and each step is measured in turn with raw TCP, round by round.

On one machine, calls take a local link instead of the engine's; local_floor has their table.
"""

from __future__ import annotations

import argparse
import itertools
import os
import queue
import statistics
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, NoReturn

import msgpack
import zenoh

from eal_actors import Fleet
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.wire.engine_setup import share_threads
from eal_actors.wire.format import keys
from tests.benchmarks import local_floor
from tests.benchmarks.least import LeastController, LeastRobot
from tests.benchmarks.network_host import FRAME, fleet_of
from tests.benchmarks.page import machine, publish
from tests.benchmarks.peers.engine import session
from tests.benchmarks.peers.peer import GIVE_UP_S, VALUE, Server, timed
from tests.benchmarks.peers.tcp import TcpClient
from tests.net.links import free_port

BEGIN: Final = "<!-- written by python -m tests.benchmarks.floor: begin -->"
CALL: Final = [10, bytes(16), 1, 1, 1.0, 5.0, None, [], None]
"""The fields of a call, as many and as long as this project's."""
FLEET, ROBOT, SECRET = "crowd", "bot1", "0" * 32
_CALL_TO: Final = keys.CallKey(FLEET, ROBOT, "Lamp", "get_value", keys.ANYBODY, SECRET)
CALL_KEY, ANSWER = keys.call_key(_CALL_TO), keys.answer_key(FLEET, keys.ANYBODY, SECRET, ROBOT)
COMMAND_KEY: Final = keys.call_key(_CALL_TO._replace(method="send_cmd"))
ANSWERS: Final = keys.answer_key(FLEET, keys.ANYBODY, SECRET, None)
VIEW: Final = FRAME.reshape(-1).data
ROUNDS, CALLS = 15, 200
PUBLISHED, THREADS, PACKED, LEAST, OURS = "published", "threads", "packed", "least", "ours"
LEAST_COMMAND, OUR_COMMAND, FRAMES, OUR_FRAMES = "least command", "our command", "frames", "our frames"
UNIX: Final = "unix"
READS: Final = PUBLISHED, UNIX, FRAMES
"""The steps in which the caller reads its answer itself, and the robot answers in the reader's thread."""
STEPS: Final = {
    PUBLISHED: "two publications, the caller reads its answer itself",
    UNIX: "the same over a Unix socket in place of TCP",
    THREADS: "a thread for the resource, one for the answers",
    PACKED: "and the fields of both messages, packed, numbered and checked",
    LEAST: "and the promises, in the least program that keeps them",
    OURS: "this project over TCP",
    LEAST_COMMAND: "a command instead, in the least program",
    OUR_COMMAND: "a command in this project over TCP",
    FRAMES: "a frame of 921,600 bytes over TCP, two publications, times raw TCP's frame",
    OUR_FRAMES: "the same in this project",
}


def _socket(port: int) -> Path:
    return Path(tempfile.gettempdir()) / f"eal-floor-{port}.sock"


def _session(step: str, port: int, *, listens: bool) -> zenoh.Session:
    return session(port, listens=listens, endpoint=f"unixsock-stream/{_socket(port)}" if step == UNIX else None)


def _publisher(opened: zenoh.Session, key: str) -> zenoh.Publisher:
    block, elsewhere = zenoh.CongestionControl.BLOCK, zenoh.Locality.REMOTE
    return opened.declare_publisher(key, congestion_control=block, express=True, allowed_destination=elsewhere)


def _subscriber(opened: zenoh.Session, expression: str, key: str) -> zenoh.Subscriber[Any]:
    """Subscribe as this project's Transport does: to many keys, of which the used ones are declared."""
    opened.declare_keyexpr(key)
    return opened.declare_subscriber(expression, zenoh.handlers.FifoChannel(64))


def _follow(opened: zenoh.Session, expression: str, key: str, handle: Callable[[zenoh.Sample], None]) -> None:
    """Handle messages in a thread, as this project's Transport does."""
    channel = _subscriber(opened, expression, key)

    def read() -> None:
        for sample in channel:
            handle(sample)

    threading.Thread(target=read, daemon=True).start()


def _unpacked(receive: Callable[[str, bytes, bytes], None]) -> Callable[[zenoh.Sample], None]:
    """Pass on what a message consists of."""

    def handle(sample: zenoh.Sample) -> None:
        attachment = sample.attachment
        envelope = b"" if attachment is None else attachment.to_bytes()
        receive(str(sample.key_expr), envelope, sample.payload.to_bytes())

    return handle


def serve(step: str, port: int) -> None:
    """Answer the calls of one step until the standard input ends."""
    opened = _session(step, port, listens=True)
    answers = _publisher(opened, ANSWER)
    if step == LEAST:
        opened.declare_keyexpr(COMMAND_KEY)
        _follow(opened, keys.call_keys(FLEET, ROBOT), CALL_KEY, _unpacked(LeastRobot(answers).receive))
        _stay()
    mailbox: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()

    def answer(envelope: bytes | None) -> None:
        if step == FRAMES:
            answers.put(bytes(VIEW))
        elif envelope is None:
            answers.put(VALUE)
        else:
            call = msgpack.unpackb(envelope)
            if list(map(type, call)) != list(map(type, CALL)):
                raise ValueError(call)
            answers.put(VALUE, attachment=msgpack.packb((10, call[3], 1, [3, 3, None, None], "era", REAL_TIME.now())))

    def receive(sample: zenoh.Sample) -> None:
        envelope = sample.attachment.to_bytes() if sample.attachment is not None else None
        if step in READS:
            answer(envelope)
        else:
            mailbox.put(envelope)

    def work() -> None:
        while True:
            answer(mailbox.get())

    threading.Thread(target=work, daemon=True).start()
    _follow(opened, keys.call_keys(FLEET, ROBOT), CALL_KEY, receive)
    _stay()


def _stay() -> NoReturn:
    """Serve until the standard input ends."""
    sys.stdout.write("up\n")
    sys.stdout.flush()
    sys.stdin.read()
    os._exit(0)


class Caller:
    """Calls by one of the steps."""

    def __init__(self, step: str, port: int) -> None:
        self._port = port
        self._opened = _session(step, port, listens=False)
        self._calls = _publisher(self._opened, CALL_KEY)
        self._numbers = itertools.count(1)
        self._pending: dict[int, tuple[threading.Lock, list[Any]]] = {}
        least = LeastController(self._calls, _publisher(self._opened, COMMAND_KEY))
        if step in READS:
            self._answers = _subscriber(self._opened, ANSWERS, ANSWER)
        else:
            _follow(self._opened, ANSWERS, ANSWER, _unpacked(least.receive) if step == LEAST else self._receive)
        gets = {THREADS: self._wait, PACKED: self._call, LEAST: least.read}
        self.get = gets.get(step, self._read)
        self.command = least.command

    def _read(self) -> None:
        self._calls.put(b"")
        self._answers.recv().payload.to_bytes()

    def _wait(self) -> None:
        self._await(0, None)

    def _call(self) -> None:
        number = next(self._numbers)
        self._await(number, msgpack.packb([*CALL[:3], number, *CALL[4:]]))

    def _await(self, number: int, envelope: bytes | None) -> None:
        woken, answer = self._pending[number] = threading.Lock(), list[Any]()
        woken.acquire()
        self._calls.put(b"", attachment=envelope)
        if not woken.acquire(timeout=GIVE_UP_S) or answer != [VALUE]:
            raise ConnectionError("no answer")

    def _receive(self, sample: zenoh.Sample) -> None:
        number = 0
        if sample.attachment is not None:
            reply = msgpack.unpackb(sample.attachment.to_bytes())
            if list(map(type, reply)) != [int, int, int, list, str, float]:
                raise ValueError(reply)
            number = reply[1]
        if pending := self._pending.pop(number, None):
            woken, answer = pending
            answer.append(sample.payload.to_bytes())
            woken.release()

    def find(self) -> None:
        """Wait until the server hears: what is published before is lost."""
        while not self._calls.matching_status:
            REAL_TIME.sleep(0.01)

    def close(self) -> None:
        self._opened.close()  # type: ignore[no-untyped-call]  # zenoh's stubs say nothing of it
        for path in (_socket(self._port), _socket(self._port).with_suffix(".sock.lock")):
            path.unlink(missing_ok=True)


def measure(rounds: int, calls: int) -> dict[str, list[float]]:
    """Return the ratio to raw TCP of each step, round by round."""
    with ExitStack() as stack:

        def started(*arguments: str) -> None:
            stack.callback(Server(["-m", *arguments]).kill)

        ports = {name: free_port() for name in ("raw TCP", *STEPS)}
        started("tests.benchmarks.peers.serve", "raw TCP", str(ports["raw TCP"]))
        raw = TcpClient(ports["raw TCP"])
        stack.callback(raw.close)
        steps: dict[str, Callable[[], object]] = {}
        for step in (FRAMES, PUBLISHED, UNIX, THREADS, PACKED, LEAST):
            started("tests.benchmarks.floor", "--serve", step, str(ports[step]))
            caller = Caller(step, ports[step])
            stack.callback(caller.close)
            caller.find()
            steps[step] = caller.get
        steps[LEAST_COMMAND] = caller.command
        started("tests.benchmarks.network_host", "1", str(ports[OURS]))
        started("tests.benchmarks.network_host", "1", str(ports[OUR_FRAMES]))
        far = [fleet_of(1, ports[step]) for step in (OURS, OUR_FRAMES)]
        far = [replace(fleet, network=replace(fleet.network, shared_memory=False)) for fleet in far]
        lamp, eye = (
            stack.enter_context(Fleet(it))["bot1"][name] for it, name in zip(far, ("Lamp", "Eye"), strict=True)
        )
        steps[OURS] = lambda: lamp.get_value().get()
        steps[OUR_COMMAND] = lambda: lamp.send_cmd("on").get()
        steps[OUR_FRAMES] = lambda: eye.get_value().get()
        for call in (raw.get, *steps.values()):
            for _ in range(calls):
                call()
        ratios: dict[str, list[float]] = {step: [] for step in steps}
        for _ in range(rounds):
            bare_s = statistics.median(timed(raw.get) for _ in range(calls))
            bare_frame_s = statistics.median(timed(raw.frame) for _ in range(calls // 10))
            for step, call in steps.items():
                is_frame = step in (FRAMES, OUR_FRAMES)
                middle_s = statistics.median(timed(call) for _ in range(calls // 10 if is_frame else calls))
                ratios[step].append(middle_s / (bare_frame_s if is_frame else bare_s))
        return ratios


def table(ratios: dict[str, list[float]]) -> str:
    """Return the steps in Markdown."""
    lines = [
        "| a reading of 24 bytes over the engine, one caller | times raw TCP | best and worst round |",
        "|---|---|---|",
    ]
    for step in STEPS:
        values = ratios[step]
        middle = statistics.median(values)
        lines.append(f"| {STEPS[step]} | {middle:.1f} | {min(values):.1f} to {max(values):.1f} |")
    return "\n".join([*lines, "", f"{machine()}; eclipse-zenoh {version('eclipse-zenoh')}."])


def main() -> None:
    """Measure, print the table, and write it into a page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", type=Path)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--serve", nargs=2)
    parser.add_argument("--serve-locally", nargs=3)
    options = parser.parse_args()
    share_threads()
    if options.serve_locally:
        robots, name, offer = options.serve_locally
        local_floor.serve(int(robots), name, offer)
        return
    if options.serve:
        serve(options.serve[0], int(options.serve[1]))
        return
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    over_engine = table(measure(options.rounds, CALLS))
    publish(f"{local_floor.table(options.rounds)}\n\n{over_engine}", options.page, BEGIN)


if __name__ == "__main__":
    main()
