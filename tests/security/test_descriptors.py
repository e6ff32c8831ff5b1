"""Strangers that connect and never finish a handshake cannot lock a robot: real TLS, few descriptors, loopback only."""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
import ssl
import threading
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.wire.security.accept_guard import ROBOT_STRANGERS, AcceptGuard, raise_file_limit
from tests.net.links import eventually
from tests.net.rig import WAIT_S, Process, Rig, ready
from tests.security.forging import make_keys, secure_rig

STOPS = 10
DRIBBLE_S = 0.2
DIALS = 50
"""Connections that dial again each time, if they were refused."""
ELSEWHERE = ("127.0.0.2",)
EVERYWHERE = tuple(f"127.0.1.{number}" for number in range(1, 201))


def client_hello() -> bytes:
    """Return the first message of a TLS handshake."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    outgoing = ssl.MemoryBIO()
    with contextlib.suppress(ssl.SSLWantReadError):
        context.wrap_bio(ssl.MemoryBIO(), outgoing, server_hostname="r1").do_handshake()
    return outgoing.read()


class Strangers:
    """Connections that are silent, dribble, begin a handshake or send their end; those that are refused dial again.

    Args:
        port: of the robot.
        count: of the connections.
        sources: loopback addresses that they come from.
    """

    def __init__(self, port: int, count: int, sources: Sequence[str]) -> None:
        self._port = port
        self._sources = itertools.cycle(sources)
        self._hello = client_hello()
        self._peers = [self._dialled() for _ in range(count)]
        self._turn = itertools.cycle(range(count))

    def _dialled(self) -> socket.socket:
        peer = socket.socket()
        peer.setblocking(False)
        peer.bind((next(self._sources), 0))
        peer.connect_ex(("127.0.0.1", self._port))
        return peer

    def talk(self, sent: int) -> None:
        """Send what is next; `sent` counts the calls."""
        for number, peer in enumerate(self._peers):
            with contextlib.suppress(OSError):  # not connected yet, or closed by the robot
                if number % 4 == 1:
                    peer.send(self._hello[sent : sent + 1])
                elif number % 4 == 2 and sent < 3:
                    peer.send(self._hello)
                elif number % 4 == 3:
                    peer.shutdown(socket.SHUT_WR)
        for number in itertools.islice(self._turn, DIALS):
            try:
                self._peers[number].getpeername()
            except OSError:
                self._peers[number].close()
                self._peers[number] = self._dialled()

    def close(self) -> None:
        """Close all of them."""
        for peer in self._peers:
            peer.close()


@contextmanager
def strangers(port: int, count: int, sources: Sequence[str] = ("127.0.0.1",)) -> Iterator[None]:
    """Attack a port for the length of a `with` block."""
    crowd, ends = Strangers(port, count, sources), threading.Event()

    def attack() -> None:
        sent = 0
        while not ends.wait(DRIBBLE_S):
            crowd.talk(sent)
            sent += 1

    with closing(crowd), ThreadPoolExecutor(1) as attacker:
        attacker.submit(attack)
        try:
            yield
        finally:
            ends.set()


@contextmanager
def with_few_descriptors(folder: Path, limit: int) -> Iterator[tuple[Rig, int, Process]]:
    """Serve a robot by a process with a limit of open files; yield its port too."""
    rig = secure_rig(folder, make_keys(folder / "keys"), 60.0)
    port = int(rig.content["robots"]["r1"]["address"].rpartition(":")[2])
    arguments = ["-m", "eal_actors", "serve", "--fleet", str(rig.file), "--robot", "r1"]
    robot = Process(arguments, folder, within=["sh", "-c", f'ulimit -n {limit}; exec "$@"', "sh"])
    try:
        robot.wait_until_listening()
        yield rig, port, robot
    finally:
        robot.end()


def stop_under_strangers(folder: Path, limit: int, count: int) -> float:
    """Stop a robot during an attack, then connect anew; return the longest time of a stop, in seconds."""
    with with_few_descriptors(folder, limit) as (rig, port, robot), ready(Fleet(rig.config)) as fleet:
        with strangers(port, count):
            robot.wait_for("too many connections")
            longest_s = 0.0
            for _ in range(STOPS):
                begin_s = REAL_TIME.now()
                assert fleet["r1"].stop("strangers").exception(timeout=WAIT_S) is None
                longest_s = max(longest_s, REAL_TIME.now() - begin_s)
                assert fleet["r1"].resume().exception(timeout=WAIT_S) is None
        assert_new_controllers_get_in(rig)
        assert fleet["r1"]["Arm"].send_cmd("step1").get(timeout=WAIT_S) == 1
    return longest_s


def connect_under_strangers(folder: Path, limit: int, count: int, sources: Sequence[str], times: int) -> list[float]:
    """Connect anew during an attack from other addresses; return how long each took, in seconds.

    The controller's address is known to the robot if the strangers have many.
    """
    taken_s = []
    with with_few_descriptors(folder, limit) as (rig, port, robot), contextlib.ExitStack() as known:
        if len(sources) > 1:
            known.enter_context(ready(Fleet(rig.config)))
        with strangers(port, count, sources):
            robot.wait_for("refused=['127.0.0.2']" if len(sources) == 1 else "passing=['127.0.0.1']")
            known.close()
            for _ in range(times):
                begin_s = REAL_TIME.now()
                with ready(Fleet(rig.config)):
                    taken_s.append(REAL_TIME.now() - begin_s)
    return taken_s


def assert_new_controllers_get_in(rig: Rig) -> None:
    with ready(Fleet(rig.config)) as other:
        assert eventually(lambda: other["r1"]["Gauge"].get_value().exception(timeout=WAIT_S) is None)


def test_strangers_with_all_descriptors_of_a_robot_do_not_lock_it(tmp_path: Path) -> None:
    stop_under_strangers(tmp_path, limit=320, count=500)


def test_a_controller_from_a_new_address_connects_under_strangers(tmp_path: Path) -> None:
    connect_under_strangers(tmp_path, limit=320, count=60, sources=ELSEWHERE, times=1)


def test_a_known_controller_connects_anew_under_strangers_from_everywhere(tmp_path: Path) -> None:
    connect_under_strangers(tmp_path, limit=320, count=200, sources=EVERYWHERE, times=1)


def test_the_guard_goes_on_when_strangers_leave_while_it_looks() -> None:
    here = Counter({"": 2 * ROBOT_STRANGERS})  # each has no address any more
    with socket.create_server(("127.0.0.1", 0)) as listener, contextlib.ExitStack() as stack:
        listener.setblocking(False)
        guard = AcceptGuard([listener.dup()], raise_file_limit(), ROBOT_STRANGERS, lambda: here, list)
        stack.callback(guard.close)
        for _ in range(2 * ROBOT_STRANGERS):
            stack.enter_context(Path(os.devnull).open(encoding="ascii"))
        assert eventually(lambda: guard._rule is not None)
        assert guard._thread.is_alive()


@pytest.mark.slow
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("sources", [ELSEWHERE, EVERYWHERE], ids=["new", "known"])
def test_controllers_connect_under_three_thousand_strangers(sources: Sequence[str], tmp_path: Path) -> None:
    taken_s = sorted(connect_under_strangers(tmp_path, limit=1024, count=3000, sources=sources, times=10))
    figures = f"median {taken_s[len(taken_s) // 2]:.1f} s, longest {taken_s[-1]:.1f} s"
    print(f"{len(taken_s)} connections under attack from {len(sources)}: {figures}")  # noqa: T201  # of the long form


@pytest.mark.slow
def test_three_thousand_strangers_do_not_delay_a_stop_by_a_second(tmp_path: Path) -> None:
    assert stop_under_strangers(tmp_path, limit=1024, count=3000) < 1.0
