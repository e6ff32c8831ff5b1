"""Links that the engine does not read are ended, and a session whose engine ends no handshake is opened again."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

import pytest
import zenoh
from structlog.testing import capture_logs

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.facade.service import RobotService
from eal_actors.wire import link_watch, session
from eal_actors.wire.link_watch import DEAF_LOOKS, LinkWatch
from eal_actors.wire.own_sockets import Link, sockets_to
from eal_actors.wire.session import open_session
from tests.net.links import eventually
from tests.net.rig import WAIT_S, Process, Rig, ready, served
from tests.security.forging import make_keys, secure_rig

ROUNDS = 40
SHORT_MS = 2
"""About as long as a handshake takes here, so that its time-out strikes near the end of some."""

MUCH_BYTES = 300_000
SHORT_OF_MEMORY = """
import resource
from eal_actors.kernel.memory import MemoryRoom
room = MemoryRoom()
shown = [room.is_short()]
used = int(open("/proc/self/statm").read().split()[5]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_DATA, (used + 32 * 2**20, used + 32 * 2**20))
shown.append(room.is_short())
much = b"x" * (24 * 2**20)
shown.append(room.is_short())
del much
room.free()
shown.append(room.is_short())
print(*shown, flush=True)
"""
ROBOT = """
import os, sys, threading
from eal_actors.managers.config import EALConfigManager
from eal_actors.wire.session import open_session, robot_config
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
config = robot_config(EALConfigManager.load(sys.argv[1]).fleet, "r1")
del config["access_control"]
config["transport"]["unicast"]["accept_timeout"] = int(sys.argv[2])
config["transport"]["link"]["tx"]["lease"] = 400
with open_session(config) as session:
    subscriber = session.declare_subscriber("ask", lambda sample: session.put("answer", sample.payload))
    print("listening", flush=True)
    threading.Event().wait()
"""


@contextmanager
def connected() -> Iterator[tuple[socket.socket, socket.socket, LinkWatch]]:
    """Yield the ends of a connection, and a watch for which the first one is a link."""
    with socket.create_server(("127.0.0.1", 0)) as listener, socket.create_connection(listener.getsockname()) as far:
        near, (host, peer_port) = listener.accept()
        port = listener.getsockname()[1]
        with near:
            yield near, far, LinkWatch(lambda: {Link(port, host, peer_port)}, frozenset({port}), None)


def test_a_link_that_is_not_read_is_ended() -> None:
    with connected() as (_, far, watch):
        far.settimeout(WAIT_S)
        far.sendall(b"call")
        for _ in range(DEAF_LOOKS + 1):
            watch.look()
        far.sendall(b"another")  # it is still there
        watch.look()
        assert far.recv(1) == b""


def test_a_link_that_is_idle_or_read_stays() -> None:
    with connected() as (near, far, watch):
        for _ in range(3 * DEAF_LOOKS):
            watch.look()
        far.sendall(bytes(20 * DEAF_LOOKS))
        for _ in range(10 * DEAF_LOOKS):
            watch.look()
            assert near.recv(1)
        far.setblocking(False)
        with pytest.raises(BlockingIOError):
            far.recv(1)


def test_while_memory_is_short_the_link_that_sent_much_is_ended() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        fars = [socket.create_connection(listener.getsockname(), WAIT_S) for _ in range(3)]
        nears = [listener.accept()[0] for _ in fars]
        port = listener.getsockname()[1]
        all_links = [Link(port, *near.getpeername()) for near in nears]
        links = set(all_links)
        watch = LinkWatch(lambda: links, frozenset({port}), None)
        with ExitStack() as stack:
            for end in (*fars, *nears):
                stack.enter_context(end)
            send(fars[0], nears[0], MUCH_BYTES)  # long ago
            watch.look()
            send(fars[1], nears[1], 2 * MUCH_BYTES)
            send(fars[2], nears[2], 10)
            for expected in ([False, True, False], [True, True, False], [True, True, False]):
                watch.relieve()
                ended = [is_ended(far) for far in fars]
                assert ended == expected
                links = {link for link, has_ended in zip(all_links, ended, strict=True) if not has_ended}


def send(far: socket.socket, near: socket.socket, count: int) -> None:
    """Send and read so many bytes."""
    far.sendall(bytes(count))
    assert len(near.recv(count, socket.MSG_WAITALL)) == count


def is_ended(far: socket.socket) -> bool:
    """Return whether the other end of a connection was shut down; on the loopback interface that shows at once."""
    far.setblocking(False)
    try:
        return far.recv(1) == b""
    except BlockingIOError:
        return False


def test_memory_is_short_near_the_limit_of_the_process(tmp_path: Path) -> None:
    process = Process(["-c", SHORT_OF_MEMORY], tmp_path)
    try:
        process.wait_for("False False True False")
    finally:
        process.end()


def test_a_session_that_ends_no_handshake_is_opened_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "_HANDSHAKE_MS", 3_600_000)
    monkeypatch.setattr(link_watch, "LOOK_S", 0.01)
    monkeypatch.setattr(link_watch, "STUCK_LOOKS", 20)
    monkeypatch.setattr(link_watch, "_SHARE", 0.05)
    rig = Rig(tmp_path)
    port = int(rig.content["robots"]["r1"]["address"].rpartition(":")[2])
    with capture_logs() as logs, RobotService(rig.config, "r1"), ready(Fleet(rig.config)) as fleet:
        with socket.create_connection(("127.0.0.1", port), WAIT_S) as silent:
            assert silent.recv(1) == b""  # closed with the old session
        assert eventually(lambda: any("the network was opened again" in line["event"] for line in logs))
        assert eventually(lambda: fleet["r1"]["Gauge"].get_value().exception(timeout=WAIT_S) is None)
        assert fleet["r1"]["Arm"].send_cmd("step1").get(timeout=WAIT_S) == 1
    assert rig.steps() == ["1"]


def test_a_fleet_that_closes_leaves_the_links_of_another_one_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session, "_QUIET_CLOSE_S", 0.0)  # as if each session closed slowly
    rig = Rig(tmp_path)
    port = int(rig.content["robots"]["r1"]["address"].rpartition(":")[2])
    with served(rig) as (_, fleet):
        (link,) = dialled(port)
        with ready(Fleet(rig.config)):
            assert len(dialled(port)) == 2
        assert fleet["r1"]["Arm"].send_cmd("step1").get(timeout=WAIT_S) == 1
        assert fleet["r1"].ping().get(timeout=WAIT_S).state is RobotState.READY
        assert dialled(port) == {link}
        assert fleet["r1"].state is RobotState.READY


def dialled(port: int) -> set[int]:
    """Return the own ports of this process's connections to a port that are open in both directions."""
    found = set()
    for end in sockets_to({port}):
        with end:
            if end.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 1) == b"\x01":  # TCP_ESTABLISHED
                found.add(end.getsockname()[1])
    return found


def is_answered(controller: zenoh.Session, answers: zenoh.Subscriber[zenoh.handlers.Handler[zenoh.Sample]]) -> bool:
    controller.put("ask", b"")
    return answers.handler.try_recv() is not None


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_handshakes_that_are_cut_off_leave_nobody_unheard(tmp_path: Path) -> None:
    rig = secure_rig(tmp_path, make_keys(tmp_path / "keys"), 60.0)
    robot = Process(["-c", ROBOT, str(rig.file), str(SHORT_MS)], tmp_path)
    try:
        robot.wait_for("listening")
        config = session.controller_config(rig.config)
        del config["access_control"]
        for number in range(ROUNDS):
            with open_session(config) as controller:
                answers = controller.declare_subscriber("answer", zenoh.handlers.FifoChannel(64))
                assert eventually(partial(is_answered, controller, answers)), number
        ended = sum("does not read a link" in line for line in robot.lines)
        print(f"{ROUNDS} controllers were answered, {ended} links were ended")  # noqa: T201  # of the long form
    finally:
        robot.end()
