"""Nobody fills a robot's memory: huge messages by observers, to denied keys and without keys are dropped on the way.

The robot has the memory of a small board: the kernel refuses more to its process (RLIMIT_DATA), which would end it.
"""

from __future__ import annotations

import contextlib
import os
import socket
import ssl
import struct
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Self

import numpy as np
import pytest
import zenoh

from eal_actors import Fleet
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import BusyError
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.wire.format import parts
from eal_actors.wire.format.packing import MAX_CALL_BYTES, PROTOCOL_VERSION, pack
from eal_actors.wire.session import controller_config, open_session
from tests.net.links import eventually
from tests.net.rig import WAIT_S, Process, Rig, ready
from tests.security.forging import as_seen_by, make_keys, secure_rig

BOARD_KB = 128 * 1024
"""Memory of the board."""
UNUSED_KB = 64 * 1024
"""Memory that numpy's BLAS reserves and never touches; the kernel's limit counts it."""
STACK_KB = 512
"""Stack of a thread. The kernel's limit counts whole stacks, of which a thread uses a fraction."""
HUGE_BYTES = 150 * 1024**2
"""More than the robot's memory."""
FRAGMENT_BYTES = 40_000
"""Less than the largest batch of a TLS link, 49,152 bytes."""
FRAGMENTS, TINY_FRAGMENTS = 1500, 1000
SEVENTH_BYTES = 10_000_000
LITTLE_BYTES = 6 * 1024**2
WAITING = 12
"""Largest calls at the same time, more than the board's memory."""
KEY_BYTES, MOST_KEYS = 2000, 60_000
LARGEST_BYTES = 900 * 1024**2
PRIORITIES = (zenoh.Priority.REAL_TIME, zenoh.Priority.INTERACTIVE_HIGH, zenoh.Priority.DATA, zenoh.Priority.BACKGROUND)
ALL_PRIORITIES = (*PRIORITIES, zenoh.Priority.INTERACTIVE_LOW, zenoh.Priority.DATA_HIGH, zenoh.Priority.DATA_LOW)
READABLE, DENIED = "eal/f/r1/Gauge/get_value/display/{}", "eal/f/r1/Arm/send_cmd/controller/{}"


@contextmanager
def on_a_small_board(rig: Rig) -> Iterator[Process]:
    """Serve the robot by a process with little memory."""
    arguments = ["-m", "eal_actors", "serve", "--fleet", str(rig.file), "--robot", "r1"]
    limits = f'ulimit -s {STACK_KB}; ulimit -d {BOARD_KB + UNUSED_KB}; exec "$@"'
    robot = Process(arguments, rig.folder, within=["sh", "-c", limits, "sh"])
    try:
        yield robot.wait_until_listening()
    finally:
        robot.end()


@contextmanager
def stranger(config: FleetConfig) -> Iterator[zenoh.Session]:
    """Open a session that does not keep itself to its role."""
    raw = controller_config(config)
    raw.pop("access_control", None)
    with open_session(raw) as session:
        assert eventually(lambda: list(session.info.peers_zid()))
        yield session


def send_huge(config: FleetConfig, key: str, size: int, duration_s: float) -> int:
    """Send huge messages of all priorities for some seconds, at least one; return their number."""
    sent, end_s = 0, REAL_TIME.now() + duration_s
    huge = bytes(size)
    while not sent or REAL_TIME.now() < end_s:
        with stranger(config) as session:
            priority = PRIORITIES[sent % len(PRIORITIES)]
            session.put(key, huge, priority=priority, congestion_control=zenoh.CongestionControl.BLOCK)
            sent += 1
    return sent


def attack(rig: Rig, attacker: FleetConfig, size: int = HUGE_BYTES, duration_s: float = 0.0) -> None:
    """Attack a robot on a small board; assert that it stays small and continues."""
    with on_a_small_board(rig) as robot, ready(Fleet(rig.config)) as fleet:
        assert fleet["r1"]["Arm"].send_cmd("step1").get(timeout=WAIT_S) == 1
        before = robot.memory_bytes()
        assert before < BOARD_KB * 1024
        sent = {key: send_huge(attacker, key.format("0" * 32), size, duration_s / 2) for key in (READABLE, DENIED)}
        peak = robot.peak_memory_bytes()
        figures = f"{sent} messages of {size / 1e6:.0f} MB: memory grew from {before / 1e6:.0f} to {peak / 1e6:.0f} MB"
        print(figures)  # noqa: T201  # of the long form
        assert peak < BOARD_KB * 1024
        assert eventually(lambda: fleet["r1"]["Arm"].send_cmd("step2").exception(timeout=WAIT_S) is None)


def number_bytes(value: int) -> bytes:
    """Return a whole number as the engine writes it: seven bits in each byte, the lowest first."""
    head = b""
    while value > 0x7F:
        head, value = head + bytes([value & 0x7F | 0x80]), value >> 7
    return head + bytes([value])


class Wire:
    """A hand-made client of the engine's own protocol, over TLS.

    Source: eclipse-zenoh, commons/zenoh-protocol/src/transport/{init,open,fragment}.rs.
    """

    def __init__(self, rig: Rig, name: str) -> None:
        keys = rig.folder / "keys"
        context = ssl.create_default_context(cafile=keys / "ca.pem")
        context.load_cert_chain(keys / f"{name}.pem", keys / f"{name}.key")
        place = "127.0.0.1", int(rig.content["robots"]["r1"]["address"].rpartition(":")[2])
        self._link = context.wrap_socket(socket.create_connection(place, WAIT_S), server_hostname=place[0])

    def __enter__(self) -> Self:
        zid = os.urandom(8)
        self.send(bytes([0x01, 0x09, (len(zid) - 1) << 4 | 0b10]) + zid)
        answer = self._receive()
        assert answer[0] & 0x3F == 0x21
        begin = 4 + (answer[2] >> 4) + (3 if answer[0] & 0x40 else 0)
        length, begin = answer[begin], begin + 1
        if length & 0x80:
            length, begin = length & 0x7F | answer[begin] << 7, begin + 1
        self.send(b"\x42" + number_bytes(60) + number_bytes(0) + number_bytes(length) + answer[begin : begin + length])
        assert self._receive()[0] & 0x3F == 0x22
        return self

    def __exit__(self, *_: object) -> None:
        self._link.close()

    def send(self, message: bytes) -> None:
        self._link.sendall(struct.pack("<H", len(message)) + message)

    def _receive(self) -> bytes:
        (length,) = struct.unpack("<H", self._exactly(2))
        return self._exactly(length)

    def _exactly(self, count: int) -> bytes:
        content = b""
        while len(content) < count:
            received = self._link.recv(count - len(content))
            assert received, "the robot has closed the link"
            content += received
        return content


def send_fragments(rig: Rig) -> None:
    """Send fragments that never end: some of one byte, then some megabytes."""
    with Wire(rig, "display") as wire:
        for number in range(FRAGMENTS):
            content = b"x" if number < TINY_FRAGMENTS else bytes(FRAGMENT_BYTES)
            wire.send(b"\x66" + number_bytes(number) + content)  # reliable, more follows


def send_seven(attacker: FleetConfig) -> None:
    """Send a message of 10 MB with each of seven priorities at the same time."""
    with stranger(attacker) as session, ThreadPoolExecutor(len(ALL_PRIORITIES)) as pool:

        def send(priority: zenoh.Priority) -> None:
            block = zenoh.CongestionControl.BLOCK
            session.put(DENIED.format("0" * 32), bytes(SEVENTH_BYTES), priority=priority, congestion_control=block)

        list(pool.map(send, ALL_PRIORITIES))


def send_parts(attacker: FleetConfig) -> None:
    """Begin the largest calls that an observer may make, and never end them."""
    secret = "0" * 32
    with stranger(attacker) as session:
        for number in range(20):
            row = pack((PROTOCOL_VERSION, number, 0, parts.MAX_BYTES, 0), "part")
            for key in (f"eal/f/r1/Gauge/send_req/display/{secret}", DENIED.format(secret)):
                session.put(key, bytes(parts.PART_BYTES), attachment=row)


def test_what_the_engine_or_the_robot_would_collect_takes_no_memory(tmp_path: Path) -> None:
    rig = secure_rig(tmp_path, make_keys(tmp_path / "keys"), 60.0)
    attacker = as_seen_by(rig.config, "display")
    with on_a_small_board(rig) as robot, ready(Fleet(rig.config)) as fleet:
        before = robot.memory_bytes()
        send_fragments(rig)
        send_seven(attacker)
        assert fleet["r1"]["Gauge"].get_value().get(timeout=WAIT_S).value == -42
        grown = robot.peak_memory_bytes() - before
        assert grown < LITTLE_BYTES
        send_parts(attacker)
        assert fleet["r1"]["Eye"].set_value(np.zeros(MAX_CALL_BYTES, np.uint8)).get(timeout=WAIT_S) == MAX_CALL_BYTES
        grown = robot.peak_memory_bytes() - before
        print(f"memory grew by {grown / 1e6:.0f} MB")  # noqa: T201  # of the long form
        assert grown < parts.MAX_TOTAL_BYTES + LITTLE_BYTES


def test_large_values_that_wait_are_bounded(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    with on_a_small_board(rig) as robot, ready(Fleet(rig.config)) as fleet:
        before, eye = robot.memory_bytes(), fleet["r1"]["Eye"]
        slow = eye.send_req("slow2", timeout_s=WAIT_S)
        calls = [eye.set_value(np.zeros(MAX_CALL_BYTES, np.uint8), timeout_s=WAIT_S) for _ in range(WAITING)]
        errors = [call.exception(timeout=WAIT_S) for call in calls]
        assert slow.exception(timeout=WAIT_S) is None
        assert any(isinstance(error, BusyError) for error in errors)
        assert robot.peak_memory_bytes() - before < 5 * MAX_CALL_BYTES
        assert eye.set_value(np.zeros(MAX_CALL_BYTES, np.uint8)).get(timeout=WAIT_S) == MAX_CALL_BYTES


def send_keys(rig: Rig, sent: int) -> int:
    """Declare keys, which access control does not look at; return how many until the robot ends the link."""
    number = 0
    with contextlib.suppress(OSError), Wire(rig, "display") as wire:
        for number in range(sent):
            key = f"a{number}/".encode() + b"y" * KEY_BYTES
            declare = b"\x1e\x20" + number_bytes(number + 1) + number_bytes(0) + number_bytes(len(key)) + key
            wire.send(b"\x25" + number_bytes(number) + declare)
        return sent
    return number


@pytest.mark.slow
def test_keys_that_fill_the_memory_end_their_link(tmp_path: Path) -> None:
    rig = secure_rig(tmp_path, make_keys(tmp_path / "keys"), 60.0)
    with on_a_small_board(rig) as robot, ready(Fleet(rig.config)) as fleet:
        end_s = REAL_TIME.now() + 60.0
        sent, cuts = 0, 0
        while REAL_TIME.now() < end_s:
            taken = send_keys(rig, MOST_KEYS)
            sent, cuts = sent + taken, cuts + (taken < MOST_KEYS)
        robot.wait_for("memory is short")
        peak = robot.peak_memory_bytes()
        print(f"{sent} keys, {cuts} links ended, memory at most {peak / 1e6:.0f} MB")  # noqa: T201  # of the long form
        assert peak < BOARD_KB * 1024
        assert eventually(lambda: fleet["r1"].stop("attack").exception(timeout=WAIT_S) is None)


@pytest.mark.slow
def test_huge_messages_of_an_observer_take_no_memory(tmp_path: Path) -> None:
    rig = secure_rig(tmp_path, make_keys(tmp_path / "keys"), 60.0)
    attack(rig, as_seen_by(rig.config, "display"))


@pytest.mark.slow
def test_a_minute_of_huge_messages_takes_no_memory(tmp_path: Path) -> None:
    rig = secure_rig(tmp_path, make_keys(tmp_path / "keys"), 60.0)
    attack(rig, as_seen_by(rig.config, "display"), LARGEST_BYTES, 60.0)


@pytest.mark.slow
def test_a_minute_of_huge_messages_without_keys_takes_no_memory(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    attack(rig, rig.config, LARGEST_BYTES, 60.0)
