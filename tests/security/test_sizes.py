"""Nobody fills a robot's memory: huge messages by observers, to denied keys and without keys are dropped on the way.

The robot has the memory of a small board: the kernel refuses more to its process (RLIMIT_DATA), which would end it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zenoh

from eal_actors import Fleet
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.managers.fleet_model import FleetConfig
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
LARGEST_BYTES = 900 * 1024**2
PRIORITIES = (zenoh.Priority.REAL_TIME, zenoh.Priority.INTERACTIVE_HIGH, zenoh.Priority.DATA, zenoh.Priority.BACKGROUND)
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
