"""Large values on one machine: they bypass the link, outlive kills without a trace, and fall back to the link."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from eal_actors import Fleet
from eal_actors.actors.handles import ResourceHandle
from eal_actors.actors.robot_view import RobotState
from eal_actors.facade.service import RobotService
from eal_actors.kernel.errors import UnavailableError
from eal_actors.managers.keys.certificates import make_authority, make_certificate
from tests.net.links import eventually
from tests.net.rig import WAIT_S, Rig, becomes, process, ready, servers

FRAME_BYTES = 480 * 640 * 3
READER = """
import os, resource, sys
from eal_actors import Fleet

limit = int(sys.argv[2])
if limit:
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
with Fleet.load(sys.argv[1]) as fleet:
    while True:
        for robot in fleet.values():
            assert robot["Eye"].get_value().get().length == 480 * 640 * 3
        print("read", flush=True)
"""


def memories(pid: int) -> set[str]:
    """Return the shared memories that a process has mapped, by their inodes."""
    lines = Path(f"/proc/{pid}/maps").read_text(encoding="utf-8").splitlines()
    return {line.split()[4] for line in lines if "memfd:eal-values" in line}


def share(server: int, controller: int) -> None:
    """Wait until two processes share memory."""
    assert eventually(lambda: memories(server) & memories(controller))


def begin_sharing(eye: ResourceHandle, server: int | None = None) -> None:
    """Read values until they come in memory that this process shares with a server."""
    server = server or os.getpid()
    assert eventually(lambda: eye.get_value().get().length and memories(os.getpid()) & memories(server))
    eye.get_value().get()


@contextmanager
def sent_bytes() -> Iterator[list[int]]:
    """Count what this process writes into all its sockets and files."""

    def written() -> int:
        fields = Path("/proc/self/io").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) for line in fields if line.startswith("wchar"))

    counted, start = [0], written()
    yield counted
    counted[0] = written() - start


def test_frames_and_streams_bypass_the_link(rig: Rig) -> None:
    with rig.served_here() as fleet:
        eye = fleet["r1"]["Eye"]
        true = (np.arange(FRAME_BYTES) % 251).astype(np.uint8).reshape(480, 640, 3)
        begin_sharing(eye)
        with sent_bytes() as sent, eye.stream(50) as stream:
            for _ in range(20):
                assert np.array_equal(eye.get_value().get().value, true)
                assert np.array_equal(next(stream).value, true)
        assert sent[0] < FRAME_BYTES


def test_threads_and_two_controllers_read_whole_frames(rig: Rig) -> None:
    with rig.served_here() as fleet, ready(Fleet(rig.config)) as second:
        wrong: list[int] = []

        def read(eye: ResourceHandle) -> None:
            wrong.extend(1 for _ in range(20) if int(eye.get_value().get().value.ravel()[:251].sum()) != 250 * 251 // 2)

        eyes = [fleet["r1"]["Eye"], second["r1"]["Eye"]]
        with eyes[0].stream(50) as first_stream, eyes[1].stream(50) as second_stream:
            threads = [threading.Thread(target=read, args=(eye,)) for eye in eyes * 4]
            for thread in threads:
                thread.start()
            for _ in range(10):
                assert next(first_stream).value[0, 0, 2] == next(second_stream).value[0, 0, 2] == 2
            for thread in threads:
                thread.join(WAIT_S)
        assert not wrong


def kill_robots(rig: Rig, kills: int) -> None:
    """Kill a robot many times while its frames are read."""
    before = memories(os.getpid())
    with servers(rig) as running, ready(Fleet(rig.config)) as fleet:
        eye = fleet["r1"]["Eye"]
        for _ in range(kills):
            begin_sharing(eye, running["r1"].pid)
            reading = eye.get_value(timeout_s=WAIT_S)
            running["r1"].kill()
            error = reading.exception(timeout=2 * WAIT_S)
            assert error is None or isinstance(error, UnavailableError)
            del reading  # its value may be in use otherwise, and keeps the memory
            assert len(memories(os.getpid()) - before) <= 2
            running.start("r1")
            assert becomes(fleet["r1"], RobotState.READY)
    assert memories(os.getpid()) == before


def test_killed_robots_leave_no_memory(rig: Rig) -> None:
    kill_robots(rig, 1)


@pytest.mark.slow
def test_killed_robots_leave_no_memory_long(rig: Rig) -> None:
    kill_robots(rig, 50)


def kill_controllers(rig: Rig, kills: int) -> None:
    with RobotService(rig.config, "r1"):
        for _ in range(kills):
            with process(["-c", READER, str(rig.file), "0"], rig.folder) as reader:
                share(os.getpid(), reader.pid)
                reader.kill()
        assert eventually(lambda: not memories(os.getpid()))


def test_killed_controllers_leave_no_memory(rig: Rig) -> None:
    kill_controllers(rig, 1)


@pytest.mark.slow
def test_killed_controllers_leave_no_memory_long(rig: Rig) -> None:
    kill_controllers(rig, 50)


def test_without_memory_frames_come_over_the_link_after_one_warning(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ("r1", "r2"))
    with rig.served_here(), process(["-c", READER, str(rig.file), str(FRAME_BYTES)], rig.folder) as reader:
        reader.wait_for("no shared memory")
        done = reader.lines.count("read\n")
        assert eventually(lambda: reader.lines.count("read\n") > done + 2)
        assert not memories(reader.pid)
        assert sum("no shared memory" in line for line in reader.lines) == 1, reader.lines


def test_a_fleet_may_forbid_it(tmp_path: Path) -> None:
    with Rig(tmp_path, network={"shared_memory": False}).served_here() as fleet:
        before = memories(os.getpid())
        for _ in range(3):
            assert fleet["r1"]["Eye"].get_value().get().length == FRAME_BYTES
        assert memories(os.getpid()) == before


def test_an_observer_with_a_certificate_shares_memory(tmp_path: Path) -> None:
    make_authority(tmp_path / "keys", "f")
    make_certificate(tmp_path / "keys", "r1", ["127.0.0.1"])
    make_certificate(tmp_path / "keys", "watcher")
    security = {"controller": "watcher", "roles": {"observers": ["watcher"]}}
    rig = Rig(tmp_path, network={"security": security}, protocol="tls")
    with RobotService(rig.config, "r1"), ready(Fleet(rig.config)) as fleet:
        begin_sharing(fleet["r1"]["Eye"])
