"""The least cost of calls on one machine, where they take a local link: the second table of tests.benchmarks.floor.

Each figure of this project stands beside that of the least program that keeps the same promises (least.py), over a
packet socket and shared memory as this project uses them, and beside raw TCP: all in turn in one run on one core.
"""

from __future__ import annotations

import os
import socket
import statistics
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any, Final

import msgpack

from eal_actors import gather
from eal_actors.wire.format import keys
from eal_actors.wire.shared_memory import MemoryOffer, OwnedMemory, PeerMemory
from tests.benchmarks.least import LeastController, LeastRobot
from tests.benchmarks.network_host import FRAME
from tests.benchmarks.peers.peer import CALLERS, ROBOTS, Server
from tests.benchmarks.peers.tcp import Tcp
from tests.benchmarks.versions import connected, median_s, together_s
from tests.net.links import free_port

_KEY: Final = keys.CallKey("crowd", "bot1", "Lamp", "get_value", keys.ANYBODY, "0" * 32)
ROWS: Final = {
    "a reading": ("get", 200),
    "a command": ("command", 200),
    f"a reading where {CALLERS} callers read at once": ("callers", 50),
    f"one command to {ROBOTS} robots of one process": ("fan_out", 5),
    "a frame of 921,600 bytes in shared memory": ("frame", 20),
}
"""The operations, and how often each is repeated in a round."""


class _Packets:
    """Publishes with one key over a packet socket."""

    def __init__(self, end: socket.socket, key: str) -> None:
        self._send, self._key, self._pack = end.send, key, msgpack.Packer().pack

    def put(self, payload: bytes, *, attachment: bytes) -> None:
        self._send(self._pack((self._key, attachment, payload)), socket.MSG_DONTWAIT)


def _read(end: socket.socket, receivers: dict[str, Callable[[str, bytes, bytes], None]], robot_at: int) -> None:
    """Pass each message on to its robot's end."""
    buffer = memoryview(bytearray(65_536))
    while length := end.recv_into(buffer):
        key, envelope, payload = msgpack.unpackb(buffer[:length])
        receivers[key.split("/")[robot_at]](key, envelope, payload)


def serve(robots: int, name: str, offer: str) -> None:
    """Serve the least robots over a packet socket until the standard input ends; with frames if memory is offered."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener.bind(f"\0{name}")
    listener.listen()
    sys.stdout.write("up\n")
    sys.stdout.flush()
    end, _ = listener.accept()
    fields = tuple(text if len(text) == 32 else int(text) for text in offer.split())
    memory = PeerMemory(MemoryOffer.parse(fields)) if fields else None
    receivers = {}
    for robot in (f"bot{number}" for number in range(1, robots + 1)):
        answers = _Packets(end, keys.answer_key(_KEY.fleet, _KEY.caller, _KEY.client, robot))
        receivers[robot] = LeastRobot(answers, memory).receive
    threading.Thread(target=_read, args=(end, receivers, 2), daemon=True).start()
    sys.stdin.read()
    os._exit(0)


def _least(stack: ExitStack, robots: int, *, has_frames: bool = False) -> list[LeastController]:
    """Return the controllers of the least robots, which another process serves."""
    memory = OwnedMemory(FRAME.nbytes) if has_frames else None
    name, offer = f"eal-floor-{free_port()}", "" if memory is None else " ".join(map(str, memory.offer))
    stack.callback(Server(["-m", "tests.benchmarks.floor", "--serve-locally", str(robots), name, offer]).kill)
    end = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
    end.connect(f"\0{name}")
    if memory is not None:
        memory.allocate()
        stack.callback(memory.close)
    controllers, receivers = [], {}
    for robot in (f"bot{number}" for number in range(1, robots + 1)):
        key = _KEY._replace(robot=robot)
        reads, commands = (
            _Packets(end, keys.call_key(key._replace(method=method))) for method in ("get_value", "send_cmd")
        )
        controllers.append(LeastController(reads, commands, memory))
        receivers[robot] = controllers[-1].receive
    stack.callback(end.shutdown, socket.SHUT_RDWR)
    threading.Thread(target=_read, args=(end, receivers, -1), daemon=True).start()
    for controller in controllers:
        controller.read()  # a command needs the robot's clock
    return controllers


def _actions(stack: ExitStack) -> tuple[dict[str, Callable[[], object]], ...]:
    """Return the operations in the least program and in this project."""
    (one,), (eye,), crowd = _least(stack, 1), _least(stack, 1, has_frames=True), _least(stack, ROBOTS)
    robot = connected(stack, 1)["bot1"]
    lamps = [other["Lamp"] for other in connected(stack, ROBOTS).values()]

    def fan_out() -> None:
        for call in [controller.start(["on"], is_command=True) for controller in crowd]:
            call.get()

    def read() -> object:
        return robot["Lamp"].get_value().get()

    return (
        {"get": one.read, "command": one.command, "callers": one.read, "fan_out": fan_out, "frame": eye.read},
        {
            "get": read,
            "command": lambda: robot["Lamp"].send_cmd("on").get(),
            "callers": read,
            "fan_out": lambda: gather([lamp.send_cmd("on") for lamp in lamps]).get(),
            "frame": lambda: robot["Eye"].get_value().get(),
        },
    )


def table(rounds: int) -> str:
    """Return the ratios to raw TCP in Markdown."""
    with ExitStack() as stack:
        raw: Any = Tcp()
        stack.callback(raw.close)
        programs = _actions(stack)
        ratios: dict[str, list[list[float]]] = {title: [[] for _ in programs] for title in ROWS}
        for is_warm in (False, *[True] * rounds):
            for title, (what, count) in ROWS.items():
                bare_s = getattr(raw, what)(count)
                measure = together_s if what == "callers" else median_s
                for values, actions in zip(ratios[title], programs, strict=True):
                    ratio = measure(actions[what], count) / bare_s
                    if is_warm:
                        values.append(ratio)
    lines = [
        "| on one machine, times raw TCP | least program | this project | best and worst round |",
        "|---|---|---|---|",
    ]
    for title, (least, ours) in ratios.items():
        middles = f"{statistics.median(least):.1f} | {statistics.median(ours):.1f}"
        lines.append(f"| {title} | {middles} | {min(ours):.1f} to {max(ours):.1f} |")
    return "\n".join(lines)
