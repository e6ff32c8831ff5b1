"""Calls that a certificate permits, sent in floods or with huge texts, harm nobody else."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.facade.service import RobotService
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import EALError
from eal_actors.wire.format import keys
from eal_actors.wire.format.messages import ACCEPTED, CallHeader, encode_call
from eal_actors.wire.session import controller_config, open_session
from tests.net.links import eventually
from tests.net.rig import WAIT_S, Rig, ready
from tests.security.forging import RawClient, make_keys, raw_client, secure_rig
from tests.security.test_sizes import LITTLE_BYTES, on_a_small_board

DEAD_MAN_S = 1.0
TOLERANCE_S = 2.0
"""More than a loaded machine delays a halt; the flood delayed it by more than its own length."""
FLOOD_S = 4.0
_PAUSE_S = 0.01
"""Pause after each hundred calls: 10,000 calls a second are several times what a robot answers."""
LONG_TEXT = "y" * 43_000
"""Text that fits into one message."""
LONG_CALLS = 150
READS, READ_BYTES = 24, 2 * 1024**2


@pytest.fixture(scope="module")
def keys_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_keys(tmp_path_factory.mktemp("keys"))


@contextmanager
def flood(client: RawClient, resource: str, method: str, *arguments: str | int) -> Iterator[None]:
    """Repeat a call without waiting for its replies, for FLOOD_S."""
    envelope, _ = encode_call(CallHeader(client.id, 1, 1, 60.0, 60.0, None, arguments))
    end_s = REAL_TIME.now() + FLOOD_S

    def send() -> None:
        while REAL_TIME.now() < end_s:
            for _ in range(100):
                client.put(resource, method, envelope)
            REAL_TIME.sleep(_PAUSE_S)

    with ThreadPoolExecutor(1) as sender:
        sent = sender.submit(send)
        yield
        sent.result()


def test_handshakes_of_an_observer_delay_no_dead_mans_switch(tmp_path: Path, keys_folder: Path) -> None:
    rig = secure_rig(tmp_path, keys_folder, DEAD_MAN_S)
    with (
        on_a_small_board(rig) as robot,
        raw_client(rig.config, "controller") as holder,
        raw_client(rig.config, "display") as display,
        raw_client(rig.config, "mate") as mate,
    ):
        holder.ping()
        before = robot.memory_bytes()
        with flood(display, keys.ROBOT, keys.HELLO, "display@desk"):
            REAL_TIME.sleep(1.0)
            assert holder.call("Arm", "send_cmd", "move60") is ACCEPTED
            begun_s = rig.notes("begin")[0].time_s
            assert eventually(lambda: rig.notes("halt"))
            assert isinstance(mate.call(keys.ROBOT, keys.HELLO, "mate@desk"), dict)
        assert rig.notes("halt")[0].time_s - begun_s < DEAD_MAN_S + TOLERANCE_S
        assert robot.peak_memory_bytes() - before < 3 * LITTLE_BYTES  # 45 MB with a queue without a bound


@pytest.mark.parametrize("arguments", [("step1", LONG_TEXT), (LONG_TEXT,)], ids=["of a wrong number", "unknown"])
def test_errors_of_long_commands_take_no_memory(tmp_path: Path, keys_folder: Path, arguments: tuple[str, ...]) -> None:
    rig = secure_rig(tmp_path, keys_folder, 60.0)
    with on_a_small_board(rig) as robot, raw_client(rig.config, "mate") as mate:
        mate.ping()
        before = robot.memory_bytes()
        for _ in range(LONG_CALLS):
            assert isinstance(mate.call("Arm", "send_cmd", *arguments), EALError)
        assert robot.peak_memory_bytes() - before < LITTLE_BYTES


def test_long_commands_do_not_wait(tmp_path: Path, keys_folder: Path) -> None:
    rig = secure_rig(tmp_path, keys_folder, 60.0)
    with on_a_small_board(rig) as robot, raw_client(rig.config, "mate") as mate:
        mate.ping()
        before = robot.memory_bytes()
        assert mate.call("Arm", "send_cmd", "move60") is ACCEPTED
        for _ in range(LONG_CALLS):
            assert isinstance(mate.call("Arm", "send_cmd", f"step1{LONG_TEXT}"), EALError)
        assert robot.peak_memory_bytes() - before < LITTLE_BYTES


def test_large_values_of_past_commands_are_kept_within_bounds(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    with on_a_small_board(rig) as robot, ready(Fleet(rig.config)) as fleet:
        line = fleet["r1"]["Line"]
        before = robot.memory_bytes()
        for _ in range(READS):
            assert line.write_comm(bytes(READ_BYTES)).get(timeout=WAIT_S) == READ_BYTES
            assert len(line.read_comm(READ_BYTES).get(timeout=WAIT_S).value) == READ_BYTES
        assert robot.peak_memory_bytes() - before < READS * READ_BYTES / 2


def test_a_long_reason_of_a_stop_is_cut_short(tmp_path: Path, keys_folder: Path) -> None:
    rig = secure_rig(tmp_path, keys_folder, 60.0)
    with (
        RobotService(rig.config, "r1"),
        raw_client(rig.config, "mate") as mate,
        raw_client(rig.config, "display") as display,
    ):
        assert mate.call(keys.ROBOT, keys.STOP, "why " + 20 * LONG_TEXT) == 1
        reason = display.ping()["stopped"]
        assert reason.startswith("why yyy")
        assert len(reason) < 1000


def test_without_security_nobody_claims_the_name_of_a_certificate(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    with RobotService(rig.config, "r1"), open_session(controller_config(rig.config)) as session:
        mallory, anybody = RawClient(session, "mallory"), RawClient(session, keys.ANYBODY)
        mallory.put(keys.ROBOT, keys.HELLO, encode_call(CallHeader(mallory.id, 1, 1, 60.0, 60.0))[0])
        mallory.beat()
        assert isinstance(anybody.call(keys.ROBOT, keys.HELLO, "desk"), dict)
        assert mallory.heard_nothing
