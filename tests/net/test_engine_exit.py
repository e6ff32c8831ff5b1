"""A program with open sessions ends with its own exit code: no thread is in the engine when the interpreter ends."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest
import zenoh

from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.wire.session import open_session, probe_config, router_config
from tests.net.links import free_port
from tests.net.rig import WAIT_S, Rig

LISTENER = """
import sys, threading
from eal_actors.wire.session import open_session, probe_config
from eal_actors.wire.transport import Transport
arrived = threading.Event()
session = open_session(probe_config(sys.argv[1]))
transport = Transport(session.__enter__())
transport.receive("eal/ticks", "reader", lambda *_: arrived.set())
assert arrived.wait(30)
"""
"""It receives messages, and ends without closing its session."""

OWNER = """
import json, sys, threading
import zenoh
from eal_actors.wire.engine_exit import start_thread
from eal_actors.wire.session import probe_config
is_open = threading.Event()
def own():
    session = zenoh.open(zenoh.Config.from_json5(json.dumps(probe_config(sys.argv[1]))))
    is_open.set()
start_thread(own, "owner")
assert is_open.wait(30)
"""
"""Its thread ends with the program, and frees its session then: without a Python frame of its own."""

USER = """
import os, signal, sys, threading
from eal_actors import EALError, Fleet
fleet = Fleet.load(sys.argv[1]).connect()
gauge = fleet["r1"]["Gauge"]
gauge.get_value(timeout_s=30).get()
begins = threading.Barrier(5)
def read():
    begins.wait()
    try:
        while True:
            gauge.get_value(timeout_s=5).get()
    except EALError:
        pass
for _ in range(4):
    threading.Thread(target=read, daemon=True).start()
begins.wait()
match sys.argv[2]:
    case "sys.exit": sys.exit(7)
    case "close": fleet.close()
    case "SIGTERM" | "SIGINT" as name: os.kill(os.getpid(), signal.Signals[name])
"""
"""Four threads read while the program ends in one of several ways."""

PARENT = """
import os, sys, time
from eal_actors import Fleet
fleet = Fleet.load(sys.argv[1]).connect()
gauge = fleet["r1"]["Gauge"]
gauge.get_value(timeout_s=30).get()
child = os.fork()
if not child:
    sys.exit(5)
before_s = time.monotonic()
_, status = os.waitpid(child, 0)
assert time.monotonic() - before_s < 5, "the child has waited"
assert gauge.get_value(timeout_s=30).get().value == -42
sys.exit(os.waitstatus_to_exitcode(status))
"""
"""Its child ends with an exit code of its own, and leaves the parent's fleet alone."""

LEAVER = """
import os, sys, time
from eal_actors import Fleet, connect
how, file = sys.argv[1:]
with Fleet.load(file) if how == "Fleet" else connect("r1", fleet=file):
    if child := os.fork():
        before_s = time.monotonic()
        _, status = os.waitpid(child, 0)
        assert time.monotonic() - before_s < 5, "the child has waited"
sys.exit(os.waitstatus_to_exitcode(status) if child else 5)
"""
"""Its child leaves a `with` block that its parent has entered."""

FORKING = """
import os, sys
from eal_actors import EALError, Fleet
file, errors = sys.argv[1], []
with Fleet.load(file) as fleet:
    robot, (reader, writer) = fleet["r1"], os.pipe()
    if not os.fork():
        for use in (lambda: robot["Gauge"].get_value().get(), lambda: robot.halt().get(), Fleet.load(file).connect):
            try:
                use()
            except EALError as error:
                errors.append(f"{type(error).__name__}: {error}")
        os.write(writer, "|".join(errors).encode())
        os._exit(0)
    os.close(writer)
    told = os.fdopen(reader).read()
    assert robot["Gauge"].get_value(timeout_s=30).get().value == -42
sys.exit(told)
"""
"""Its child reads and halts a robot of its parent's fleet, and opens a fleet of its own."""

LOOKING = """
import socket, time
from eal_actors import Fleet
from tests.net.links import fleet_of
server = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
server.bind(("127.0.0.53", 53))
fleet = Fleet(fleet_of({}, {"r1": "tcp/robot.example.com:7447"})).connect(timeout_s=0.1)
server.recv(512)
print(time.monotonic())
"""
"""A name server that never answers is asked for the address of a robot."""

PRIVATELY = 'ip link set lo up && mount --bind resolv.conf /etc/resolv.conf && exec "$@"'
"""Runs a command in a namespace whose only name server is its own."""

ENDS = {"return": 0, "sys.exit": 7, "close": 0, "SIGTERM": 143, "SIGINT": -2}


def run(program: str, *arguments: object) -> subprocess.Popen[str]:
    """Start a program; Python 3.12 and later warn of its forks."""
    environment = {**os.environ, "PYTHONPATH": str(bundled_path("."))}
    command = [sys.executable, "-W", "ignore::DeprecationWarning", "-c", program, *map(str, arguments)]
    return subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)


def outcome(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Return a program's exit code and its last line of errors."""
    _, errors = process.communicate(timeout=2 * WAIT_S)
    return process.returncode, errors.strip().rpartition("\n")[2]


@contextmanager
def ticking(endpoint: str) -> Iterator[None]:
    """Send messages through a router for the length of a `with` block, as fast as their receivers take them."""
    ends = threading.Event()
    with (
        open_session(router_config([endpoint])),
        open_session(probe_config(endpoint)) as session,
        ThreadPoolExecutor(1) as sender,
    ):

        def send() -> None:
            while not ends.wait(0.001):
                session.put("eal/ticks", b"tick", congestion_control=zenoh.CongestionControl.DROP)

        sender.submit(send)
        try:
            yield
        finally:
            ends.set()


@pytest.mark.parametrize(
    "program",
    [
        pytest.param(LISTENER, id="a session that still receives"),
        pytest.param(OWNER, id="a thread that frees its session"),  # until the end looked at more than frames
    ],
)
def test_an_open_session_does_not_abort_the_program_at_its_end(program: str) -> None:
    """Every such program ended with SIGABRT."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with ticking(endpoint):
        programs = [run(program, endpoint) for _ in range(3)]
        assert [outcome(program) for program in programs] == [(0, "")] * 3


def test_a_forked_child_ends_at_once_and_leaves_its_parents_fleet_alone(rig: Rig) -> None:
    """It waited 25 s for its parent's threads."""
    with rig.served_here():
        assert outcome(run(PARENT, rig.file)) == (5, "")


@pytest.mark.parametrize("how", ["Fleet", "connect"])
def test_a_forked_child_leaves_a_with_block_of_its_parent_at_once(rig: Rig, how: str) -> None:
    """It waited 8 s for threads that it does not have."""
    with rig.served_here():
        assert outcome(run(LEAVER, how, rig.file)) == (5, "")


def test_a_forked_child_learns_that_it_cannot_use_robots(rig: Rig) -> None:
    """Calls failed at their deadlines, and robots did not answer at their addresses."""
    with rig.served_here():
        _, told = outcome(run(FORKING, rig.file))
    why = "this process is a fork, which lacks the threads of its parent: "
    reading, halt, fleet = (error.partition(why) for error in told.split("|"))
    assert reading[:2] == ("UnavailableError: r1/Gauge: ", why)
    assert halt[:2] == ("UnavailableError: r1/Arm: ", why)
    assert fleet[:2] == ("UnavailableError: ", why)
    assert 'start it with multiprocessing.get_context("spawn")' in fleet[2]


def test_a_name_server_that_is_silent_does_not_hold_up_the_end(tmp_path: Path) -> None:
    """It took 10 s."""
    (tmp_path / "resolv.conf").write_text("nameserver 127.0.0.53\n")
    namespace = ["unshare", "--map-root-user", "--mount", "--net", "sh", "-c", PRIVATELY, "sh"]
    if subprocess.run([*namespace, "true"], cwd=tmp_path, capture_output=True, check=False).returncode:
        pytest.skip("namespaces are not allowed here")
    environment = {**os.environ, "PYTHONPATH": str(bundled_path("."))}
    command = [*namespace, sys.executable, "-c", LOOKING]
    ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert REAL_TIME.now() - float(ended.stdout) < 5.0
    assert "threads are still in the network engine" not in ended.stderr


def count_endings(folder: Path, programs: int) -> dict[str, Counter[int]]:
    """Return the exit codes of programs that end while their threads read, four at once."""
    rig = Rig(folder)
    codes: dict[str, Counter[int]] = {how: Counter() for how in ENDS}
    with rig.served_here():
        for _ in range(programs // 4):
            for how, counts in codes.items():
                running = [run(USER, rig.file, how) for _ in range(4)]
                counts.update(outcome(program)[0] for program in running)
    return codes


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_two_hundred_programs_that_end_while_their_threads_read_keep_their_exit_codes(tmp_path: Path) -> None:
    """6 of 200 ended with SIGABRT."""
    codes = count_endings(tmp_path, 40)
    print(codes)  # noqa: T201  # of the long form
    assert codes == {how: Counter({code: 40}) for how, code in ENDS.items()}
