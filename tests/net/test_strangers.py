"""Peers that send invalid messages, speak another version, replay commands, or lack permission."""

from __future__ import annotations

import queue
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zenoh

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.kernel.clock import SystemClock
from eal_actors.kernel.errors import (
    AccessDeniedError,
    DeadlineError,
    EALError,
    PreemptedError,
    ProtocolError,
    StaleCommandError,
    UnavailableError,
)
from eal_actors.managers.keys.certificates import make_authority, make_certificate
from eal_actors.wire.format.keys import STOP, client_id
from eal_actors.wire.format.messages import Answer, CallHeader, CallReply, RobotTime, decode_reply, encode_call
from eal_actors.wire.format.packing import PROTOCOL_VERSION
from eal_actors.wire.rpc.client.broadcast import ask_robots
from eal_actors.wire.session import controller_config, open_session, robot_config
from tests.net.links import eventually
from tests.net.rig import WAIT_S, Rig, becomes, failure, ready, served, servers

SECRET = "ab" * 16
CLIENT = client_id("_", SECRET)


# Invalid messages.


def test_garbage_on_the_port_harms_nobody(rig: Rig) -> None:
    with served(rig) as (_, fleet):
        port = int(rig.content["robots"]["r1"]["address"].rpartition(":")[2])
        for garbage in (
            b"\x00" * 100_000,
            bytes(range(256)) * 50,
            b"GET / HTTP/1.1\r\n\r\n",
            b"\xff\xff" + b"\x01" * 65535,
            b"",
        ):
            with socket.create_connection(("127.0.0.1", port), WAIT_S) as peer:
                try:
                    peer.sendall(garbage)
                except ConnectionError:
                    continue
                assert fleet["r1"]["Gauge"].get_value().get().value == -42
        silent = [socket.create_connection(("127.0.0.1", port), WAIT_S) for _ in range(50)]
        try:
            assert fleet["r1"]["Arm"].send_cmd("step1").get() == 1
            with ready(Fleet(rig.config)) as other:
                assert other["r1"]["Gauge"].get_value().get().value == -42
        finally:
            for peer in silent:
                peer.close()
        assert fleet["r1"].state is RobotState.READY


class Stranger:
    """Sends hand-made calls to a robot."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._heard: queue.SimpleQueue[tuple[bytes, bytes]] = queue.SimpleQueue()
        self._known: set[tuple[bytes, bytes]] = set()
        session.declare_subscriber(f"eal/f/@answers/_/{SECRET}/r1", zenoh.handlers.Callback(self._hear, indirect=False))

    def _hear(self, answer: zenoh.Sample) -> None:
        assert answer.attachment is not None
        self._heard.put((answer.attachment.to_bytes(), answer.payload.to_bytes()))

    def ask(self, key: str, envelope: bytes, payload: bytes = b"", client: str = SECRET) -> CallReply:
        """Return the answer to a call. A busy robot may send an answer again, even later: that one is ignored."""
        self._session.put(f"eal/f/r1/{key}/_/{client}", payload, attachment=envelope)
        while (answer := self._heard.get(timeout=WAIT_S)) in self._known:
            pass
        self._known.add(answer)
        return decode_reply(*answer)

    def error(self, key: str, envelope: bytes, payload: bytes = b"") -> EALError:
        """Return the error with which a call is answered."""
        answer = self.ask(key, envelope, payload).answer
        assert isinstance(answer, EALError), answer
        return answer

    def command(self, header: CallHeader) -> Answer:
        """Return the answer to a command of the arm."""
        reply = self.ask("Arm/send_cmd", encode_call(header)[0])
        assert reply.sequence == header.sequence
        return reply.answer

    def robot_time(self) -> RobotTime:
        """Return the time of the robot's clock."""
        time = self.ask("_/ping", encode_call(CallHeader(CLIENT, 0, 1, 1.0, 1.0))[0]).time
        assert time is not None
        return time


@contextmanager
def stranger(rig: Rig) -> Iterator[Stranger]:
    with open_session(controller_config(rig.config)) as session:
        assert eventually(lambda: list(session.liveliness().get(f"eal/f/@alive/{PROTOCOL_VERSION}/r1")))
        yield Stranger(session)


def header(sequence: int, time: RobotTime, command: str = "step1", **changes: Any) -> CallHeader:
    """Return the header of a proper command."""
    made = CallHeader(CLIENT, 0, sequence, 5.0, 5.0, None, (command,), time.era, time.time_s, 0.0)
    return made._replace(**changes)


def test_wrong_versions_and_senseless_queries_are_answered_with_what_is_wrong(rig: Rig) -> None:
    good = encode_call(CallHeader(CLIENT, 0, 1, 1.0, 1.0))[0]
    newer = msgpack.packb([PROTOCOL_VERSION + 1, *msgpack.unpackb(good)[1:]])
    with served(rig) as (_, fleet), stranger(rig) as peer:
        for key in ("_/hello", "Gauge/get_value", "Arm/send_cmd", "Arm/halt"):
            error = peer.error(key, newer)
            assert isinstance(error, ProtocolError), key
            assert str(PROTOCOL_VERSION + 1) in error.message
            assert str(PROTOCOL_VERSION) in error.message
            for envelope in (b"", b"\xc1", b"\x00" * 1000, good[:-1], good + b"x", msgpack.packb({"a": 1})):
                assert isinstance(peer.error(key, envelope), ProtocolError), (key, envelope)
            assert peer.ask(key, newer).sequence == 0  # the call's number is unreadable
        assert isinstance(peer.error("Arm/stream", good), ProtocolError)
        assert peer.error("Nothing/get_value", good).code == "resource_not_found"
        assert isinstance(peer.error("Gauge/get_value", good, b"a payload without a type"), ProtocolError)
        assert isinstance(peer.error("_/cancel", good), EALError)
        assert isinstance(
            peer.error("_/reattach", encode_call(CallHeader(CLIENT, 0, 1, 1.0, 1.0, None, ("x", "y")))[0]), EALError
        )
        assert fleet["r1"]["Arm"].send_cmd("step1").get() == 1
    assert rig.steps() == ["1"]


def test_a_command_runs_at_most_once_and_only_when_fresh(rig: Rig) -> None:
    with served(rig) as (_, fleet), stranger(rig) as peer:
        time = peer.robot_time()
        assert peer.command(header(5, time)) == 1
        old = time._replace(time_s=time.time_s - 100.0)
        for stale in (
            header(5, time),  # a second time
            header(4, time),  # overtaken
            header(6, old),
            header(7, time._replace(time_s=time.time_s + 100.0)),
            header(8, time._replace(era="0" * 8)),  # of another run of the server
            header(9, time, era="", echo_s=0.0),
            header(10, time, ttl_s=0.0),
            header(11, time, ttl_s=-1.0),
        ):
            assert isinstance(peer.command(stale), StaleCommandError), stale
        late = peer.command(header(12, time, deadline_s=0.0))
        assert isinstance(late, DeadlineError)
        assert peer.command(header(13, time, "step2")) == 2
        assert fleet["r1"].state is RobotState.READY
    assert rig.steps() == ["1", "2"]


def test_a_command_with_senseless_arguments_is_forgotten_again(rig: Rig) -> None:
    with served(rig) as (_, _fleet), stranger(rig) as peer:
        time = peer.robot_time()
        assert isinstance(peer.command(header(1, time, arguments=(1, 2))), ProtocolError)
        known = peer.ask("_/reattach", encode_call(CallHeader(CLIENT, 0, 2, 1.0, 1.0, None, (0, 1)))[0])
        assert known.answer == {"running": [], "unknown": []}


def test_a_halt_that_overtakes_a_command_on_its_way_stops_it(rig: Rig) -> None:
    with served(rig) as (_, _fleet), stranger(rig) as peer:
        time = peer.robot_time()
        assert peer.ask("Arm/halt", encode_call(header(7, time, arguments=()))[0]).answer == 1
        assert isinstance(peer.command(header(6, time)), StaleCommandError)
        assert peer.command(header(8, time, "step8")) == 8
    assert rig.steps() == ["8"]


def test_a_robot_of_another_version_is_not_let_in(rig: Rig) -> None:
    """An impostor answers in the robot's place, in an unknown version."""
    clock = SystemClock()
    with open_session(robot_config(rig.config, "r1")) as impostor:
        due: queue.SimpleQueue[str | None] = queue.SimpleQueue()

        def answer() -> None:
            while (key := due.get()) is not None:
                impostor.put(key, b"", attachment=msgpack.packb([PROTOCOL_VERSION + 1, "whatever", {}]))

        def hear(call: zenoh.Sample) -> None:
            caller, client = str(call.key_expr).split("/")[-2:]
            due.put(f"eal/f/@answers/{caller}/{client}/r1")

        answers = threading.Thread(target=answer)
        answers.start()
        with (
            impostor.declare_subscriber("eal/f/r1/*/*/*/*", zenoh.handlers.Callback(hear, indirect=False)),
            impostor.liveliness().declare_token(f"eal/f/@alive/{PROTOCOL_VERSION}/r1"),
            Fleet(rig.config) as fleet,
        ):
            assert clock.now() < 15.0  # it was not waited for as one that still starts
            assert becomes(fleet["r1"], RobotState.LOST)
            assert eventually(lambda: f"version {PROTOCOL_VERSION + 1}" in str(fleet["r1"].problems[0])), fleet.problems
        due.put(None)
        answers.join()


def test_a_robot_of_another_release_is_seen_and_told_apart_until_it_is_updated(rig: Rig) -> None:
    """The key of the heartbeat is the only part of the protocol that all versions share."""
    other = PROTOCOL_VERSION + 1
    told: dict[str, EALError | None] = {}
    with ExitStack() as old:
        session = old.enter_context(open_session(robot_config(rig.config, "r1")))
        old.enter_context(session.liveliness().declare_token(f"eal/f/@alive/{other}/r1"))
        with Fleet(rig.config) as fleet:
            robot = fleet["r1"]
            assert robot.state is RobotState.LOST
            assert f"version {other} of the protocol, this one {PROTOCOL_VERSION}" in str(robot.problems[0])
            failure(robot.ping(), UnavailableError)
            ask_robots(rig.config, ["r1"], STOP, on_result=told.__setitem__, timeout_s=WAIT_S)
            assert isinstance(told["r1"], ProtocolError)
            assert str(other) in told["r1"].message
            old.close()
            assert eventually(lambda: "unreachable" in str(robot.problems[0]))
            with servers(rig):
                assert becomes(robot, RobotState.READY)


# Security.


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The keys of a robot and of controllers."""
    folder = tmp_path_factory.mktemp("keys")
    make_authority(folder, "f")
    make_certificate(folder, "r1", ["127.0.0.1"])
    for name in ("controller", "driver", "display", "guest", "stranger"):
        make_certificate(folder, name)
    return folder


def secured(folder: Path, keys: Path) -> Rig:
    roles = {
        "controllers": ["controller", {"name": "driver", "resources": ["Arm"]}],
        "observers": ["display", {"name": "guest", "robots": ["r1"]}],
    }
    return Rig(folder, network={"security": {"keys": str(keys), "roles": roles}}, protocol="tls")


@contextmanager
def seen_by(rig: Rig, name: str, keys: Path | None = None) -> Iterator[Fleet]:
    """Connect the fleet with the certificate of another name."""
    config = rig.config
    assert config.network.security is not None
    security = replace(config.network.security, controller=name, keys=keys or config.network.security.keys)
    with Fleet(replace(config, network=replace(config.network, security=security))) as fleet:
        yield fleet


def test_roles_hold_for_whole_robots(tmp_path: Path, keys: Path) -> None:
    rig = secured(tmp_path, keys)
    with served(rig) as (_, fleet):
        assert fleet["r1"]["Arm"].send_cmd("step1").get() == 1
        with seen_by(rig, "display") as display:
            arm = display["r1"]["Arm"]
            assert arm.get_value().get().value == 0.0
            for call in (arm.send_cmd("step2"), arm.halt(), display["r1"].stop(), display["r1"].resume()):
                assert call.done()  # refused before anything was sent
                denied = failure(call, AccessDeniedError)
                assert denied.robot == "r1"
                assert "to 'display', which has the role observer there" in denied.message
            assert failure(arm.halt(), AccessDeniedError).resource == "Arm"
            assert display["r1"].stopped_because is None
            assert display["r1"].state is RobotState.READY
            assert fleet["r1"].stopped_because is None
        assert fleet["r1"]["Arm"].send_cmd("step3").get() == 3
    assert rig.steps() == ["1", "3"]
    assert len(rig.notes("halt")) <= 3  # of those who left, and of the end


def test_a_controller_of_one_resource_can_cancel_there(tmp_path: Path, keys: Path) -> None:
    rig = secured(tmp_path, keys)
    with servers(rig), seen_by(rig, "driver") as driver:
        move = driver["r1"]["Arm"].send_cmd("move60")
        assert rig.begun("move60")
        move.cancel()
        assert eventually(lambda: rig.notes("halt"))
        denied = failure(driver["r1"]["Eye"].set_value(b"x"), AccessDeniedError)
        assert "set_value to 'driver', which has the role controller of Arm alone there" in denied.message
        assert driver["r1"]["Arm"].halt().get() == 1


def test_a_role_for_single_robots_finds_them_and_hears_their_events(tmp_path: Path, keys: Path) -> None:
    rig = secured(tmp_path, keys)
    with served(rig) as (_, fleet), seen_by(rig, "guest") as guest:
        assert becomes(guest["r1"], RobotState.READY)
        assert guest["r1"]["Gauge"].get_value().get().value == -42
        move = fleet["r1"]["Arm"].send_cmd("move60")
        assert eventually(lambda: [running.command for running in guest["r1"].running] == ["move60"])
        assert fleet["r1"]["Arm"].halt().get() == 1
        failure(move, PreemptedError)


@pytest.mark.parametrize("way", ["no role", "another authority", "no certificate"])
def test_who_is_not_known_gets_nowhere(tmp_path: Path, keys: Path, way: str) -> None:
    rig = secured(tmp_path, keys)
    forged = tmp_path / "forged"
    make_authority(forged, "f")
    make_certificate(forged, "controller")
    with served(rig) as (_, fleet):
        if way == "no certificate":
            config = controller_config(rig.config)
            tls = config["transport"]["link"]["tls"]
            config["transport"]["link"]["tls"] = {"root_ca_certificate": tls["root_ca_certificate"]}
            with open_session(config) as impostor:
                envelope = encode_call(CallHeader(CLIENT, 0, 1, 1.0, 1.0))[0]
                for _ in range(5):
                    impostor.put(f"eal/f/r1/Arm/halt/controller/{SECRET}", b"", attachment=envelope)
                    assert fleet["r1"]["Gauge"].get_value().get().value == -42
        else:
            name, folder = ("stranger", None) if way == "no role" else ("controller", forged)
            with seen_by(rig, name, folder) as other:
                assert other["r1"].state is RobotState.LOST
                assert "does not answer at tls/127.0.0.1:" in str(other.problems[0])
        assert fleet["r1"]["Arm"].send_cmd("step1").get() == 1
        assert not rig.notes("halt")
    assert rig.steps() == ["1"]
