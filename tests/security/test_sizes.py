"""Nobody fills a robot's memory: huge messages by observers, to denied keys and without keys are dropped on the way."""

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
from tests.net.rig import WAIT_S, Process, Rig, ready, servers
from tests.security.forging import as_seen_by, make_keys, secure_rig

HUGE_BYTES = 150 * 1024**2
GROWTH_BYTES = 64_000_000
"""How much the robot may grow: a board of 128 MB has as much beside it."""
PRIORITIES = (zenoh.Priority.REAL_TIME, zenoh.Priority.INTERACTIVE_HIGH, zenoh.Priority.DATA, zenoh.Priority.BACKGROUND)
READABLE, DENIED = "eal/f/r1/Gauge/get_value/display/{}", "eal/f/r1/Arm/send_cmd/controller/{}"


@contextmanager
def stranger(config: FleetConfig) -> Iterator[zenoh.Session]:
    """Open a session that does not keep itself to its role."""
    raw = controller_config(config)
    raw.pop("access_control", None)
    with open_session(raw) as session:
        assert eventually(lambda: list(session.info.peers_zid()))
        yield session


def send_huge(config: FleetConfig, key: str, duration_s: float) -> int:
    """Send huge messages of all priorities for some seconds, at least one; return their number."""
    sent, end_s = 0, REAL_TIME.now() + duration_s
    huge = bytes(HUGE_BYTES)
    while not sent or REAL_TIME.now() < end_s:
        with stranger(config) as session:
            priority = PRIORITIES[sent % len(PRIORITIES)]
            session.put(key, huge, priority=priority, congestion_control=zenoh.CongestionControl.BLOCK)
            sent += 1
    return sent


def assert_small(rig: Rig, robot: Process, attacker: FleetConfig, keys: tuple[str, ...], duration_s: float) -> None:
    """Attack a robot; assert that it stays small and goes on."""
    with ready(Fleet(rig.config)) as fleet:
        before = robot.memory_bytes()
        for key in keys:
            send_huge(attacker, key.format("0" * 32), duration_s / len(keys))
        grown = robot.peak_memory_bytes() - before
        assert grown < GROWTH_BYTES, f"{grown / 1e6:.0f} MB"
        assert fleet["r1"]["Arm"].send_cmd("step1").get(timeout=WAIT_S) == 1


def attack_with_a_certificate(folder: Path, duration_s: float) -> None:
    rig = secure_rig(folder, make_keys(folder / "keys"), 60.0)
    with servers(rig) as running:
        assert_small(rig, running["r1"], as_seen_by(rig.config, "display"), (READABLE, DENIED), duration_s)


def test_huge_messages_of_an_observer_take_no_memory(tmp_path: Path) -> None:
    attack_with_a_certificate(tmp_path, 0.0)


@pytest.mark.slow
def test_a_minute_of_huge_messages_takes_no_memory(tmp_path: Path) -> None:
    attack_with_a_certificate(tmp_path, 60.0)


@pytest.mark.slow
def test_huge_messages_without_keys_take_no_memory(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    with servers(rig) as running:
        assert_small(rig, running["r1"], rig.config, (READABLE, DENIED), 0.0)
