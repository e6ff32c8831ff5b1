"""Strangers at a robot's port, by the hundred, while its controller goes on: it must never notice."""

from __future__ import annotations

import contextlib
import resource
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random

import pytest

from eal_actors import Fleet
from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import RobotState
from eal_actors.kernel.clock import SystemClock
from eal_actors.kernel.errors import EALError
from eal_actors.wire.session import open_session, probe_config
from tests.net.links import eventually
from tests.net.rig import WAIT_S, Process, Rig, ready, served

STRANGERS = 1000
CALLS = 20
MOST_GROWTH_BYTES = 60_000_000


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path, network={"dead_man_s": 10.0, "lease_s": 10.0})


@contextmanager
def many_files(count: int) -> Iterator[None]:
    """Allow this process to have so many files open."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = max(soft, count) if hard == resource.RLIM_INFINITY else min(hard, max(soft, count))
    if wanted < count:
        pytest.skip(f"this process may open {hard} files, not {count}")
    resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def greeting() -> bytes:
    """Return what a real session says first: it is asked of one that dials a socket of ours."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(WAIT_S)
        endpoint = f"tcp/127.0.0.1:{listener.getsockname()[1]}"
        heard: list[bytes] = []

        def listen() -> None:
            peer, _ = listener.accept()
            with peer:
                peer.settimeout(WAIT_S)
                heard.append(peer.recv(65_536))

        listening = threading.Thread(target=listen)
        listening.start()
        with contextlib.suppress(EALError), open_session(probe_config(endpoint), timeout_s=1.0):
            pass
        listening.join(WAIT_S)
    assert heard
    assert len(heard[0]) > 4
    return heard[0]


def works(robot: RobotHandle, numbers: Iterator[int]) -> None:
    """Check that the robot answers its controller: readings and commands."""
    for _ in range(CALLS):
        assert robot["Gauge"].get_value(timeout_s=WAIT_S).get().value == -42
    number = next(numbers)
    assert robot["Arm"].send_cmd(f"step{number}", timeout_s=WAIT_S).get() == number


def port_of(rig: Rig) -> int:
    return int(rig.content["robots"]["r1"]["address"].rpartition(":")[2])


def files_of(process: Process) -> int:
    return len(list(Path(f"/proc/{process.pid}/fd").iterdir()))


def speak(peer: socket.socket, data: bytes) -> None:
    """Say something; being thrown out is an answer too."""
    with contextlib.suppress(OSError):
        peer.sendall(data)


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_thousand_connections(rig: Rig) -> None:
    """Silent ones, garbage, cut greetings, giant lengths: none is noticed, and nothing is left of them."""
    hello, chance, numbers = greeting(), Random(3), iter(range(1, 100))  # noqa: S311  # a test
    sayings: list[Callable[[], bytes]] = [
        lambda: b"",
        lambda: chance.randbytes(200),
        lambda: hello[: chance.randrange(len(hello))],
        lambda: hello,
        lambda: hello + hello,
        lambda: b"\xff\xff" + hello[2:],
        lambda: struct.pack("<H", 65_535) + bytes(1000),
        lambda: hello + b"\xff\xff" + chance.randbytes(1000),
    ]
    with many_files(STRANGERS + 500), served(rig) as (servers, fleet):
        robot, server = fleet["r1"], servers["r1"]
        works(robot, numbers)
        files, memory_bytes = files_of(server), server.memory_bytes()
        with contextlib.ExitStack() as strangers:
            for number in range(STRANGERS):
                peer = strangers.enter_context(socket.create_connection(("127.0.0.1", port_of(rig)), WAIT_S))
                speak(peer, sayings[number % len(sayings)]())
                if number % 200 == 199:
                    works(robot, numbers)
            assert robot.state is RobotState.READY
            works(robot, numbers)
            with ready(Fleet(rig.config)) as other:
                assert other["r1"]["Gauge"].get_value(timeout_s=WAIT_S).get().value == -42
            assert server.memory_bytes() - memory_bytes < MOST_GROWTH_BYTES
        works(robot, numbers)
        assert eventually(lambda: files_of(server) <= files + 10), (files, files_of(server))
    assert rig.steps() == [str(number) for number in range(1, 9)]
    assert len(rig.notes("halt")) <= 2  # of the end: no dead-man's switch, no restart


@pytest.mark.slow
def test_senders_that_take_their_time(rig: Rig) -> None:
    """A greeting, byte by byte, and lengths that are never filled."""
    hello, numbers, clock = greeting(), iter(range(1, 100)), SystemClock()
    with served(rig) as (_, fleet), contextlib.ExitStack() as stack:
        peers = [stack.enter_context(socket.create_connection(("127.0.0.1", port_of(rig)), WAIT_S)) for _ in range(100)]
        for byte in hello:
            for peer in peers:
                speak(peer, bytes([byte]))
            clock.sleep(0.005)
        works(fleet["r1"], numbers)
        for peer in peers:
            speak(peer, b"\xff\x7f\x00")
        works(fleet["r1"], numbers)
        with ready(Fleet(rig.config)) as other:  # nor are other controllers kept out
            assert other["r1"]["Gauge"].get_value(timeout_s=WAIT_S).get().value == -42
        assert fleet["r1"].state is RobotState.READY
