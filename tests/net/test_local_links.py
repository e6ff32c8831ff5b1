"""Local links: calls on one machine bypass the engine, keep their promises, and leave nothing behind."""

from __future__ import annotations

import contextlib
import os
import random
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eal_actors import Fleet
from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import RobotState
from eal_actors.facade.service import RobotService, serve_together
from eal_actors.kernel.errors import ProtocolError
from eal_actors.managers.keys.certificates import make_authority, make_certificate
from eal_actors.wire.format import keys
from eal_actors.wire.format.packing import PROTOCOL_VERSION
from eal_actors.wire.local_link import LocalLink, dial
from eal_actors.wire.rpc.client.controller import Controller
from eal_actors.wire.transport import Transport
from tests.net.links import Wire, eventually, free_port
from tests.net.rig import WAIT_S, Rig, becomes, ready, served

LARGE = np.arange(2_000_000, dtype=np.uint8)


def controller_of(robot: RobotHandle) -> Controller:
    controller: Controller = robot._actor._controller  # type: ignore[attr-defined]
    return controller


def links_of(robot: RobotHandle) -> dict[str, LocalLink]:
    """Return the local links of the controller of a robot."""
    return controller_of(robot).local.links


def process_of(robot: RobotHandle) -> str:
    """Return the process of a robot, as the handshake names it."""
    name: str = robot._actor._channel.process  # type: ignore[attr-defined]
    return name


def names() -> set[str]:
    """Return the names of all local links' sockets of this machine."""
    words = (line.split() for line in Path("/proc/net/unix").read_text(encoding="utf-8").splitlines())
    return {line[-1] for line in words if line[-1].startswith("@eal-")}


@pytest.fixture
def sent(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the keys of the calls and replies that go over the engine from now on."""
    noted: list[str] = []
    put = Transport.put

    def note(transport: Transport, key: str, *arguments: Any, **options: Any) -> bool:
        if "/Arm/" in key or "/Gauge/" in key or "/Eye/" in key:
            noted.append(key)
        return put(transport, key, *arguments, **options)

    monkeypatch.setattr(Transport, "put", note)
    return noted


def test_calls_bypass_the_engine(rig: Rig, remote: RobotHandle, sent: list[str]) -> None:
    assert remote["Gauge"].get_value().get().value == -42
    assert [remote["Arm"].send_cmd(f"step{number}").get() for number in range(5)] == list(range(5))
    assert remote["Eye"].set_value(LARGE).get() == LARGE.size  # in parts
    assert remote["Arm"].send_cmd("move30").cancel()
    assert remote["Arm"].halt().get() == 1
    assert not sent
    assert rig.never_twice()


def test_robots_of_one_process_share_a_link(tmp_path: Path) -> None:
    address = f"tcp/127.0.0.1:{free_port()}"
    rig = Rig(tmp_path, ("r{n}",))
    rig.content["robots"]["r{n}"].update(count=3, address=address)
    rig.write()
    config = rig.config
    with serve_together(config, list(config.robots)), ready(Fleet(config)) as fleet:
        assert len(links_of(fleet["r1"])) == 3
        assert len(set(links_of(fleet["r1"]).values())) == 1
        assert fleet.send(fleet, "Arm", "step1").get(timeout=WAIT_S) == dict.fromkeys(fleet, 1)


def test_a_killed_robot_leaves_no_name_and_is_reached_again(rig: Rig) -> None:
    with served(rig) as (running, fleet):
        robot = fleet["r1"]
        for number in range(3):
            assert links_of(robot)
            name = f"@eal-{PROTOCOL_VERSION}-{process_of(robot)}"
            assert name in names()
            assert robot["Arm"].send_cmd(f"step{number}").get() == number
            running["r1"].kill()
            assert becomes(robot, RobotState.LOST)
            assert name not in names()
            running.start("r1")
            assert becomes(robot, RobotState.READY)
    assert rig.steps() == ["0", "1", "2"]


def test_a_link_that_ends_alone_loses_no_call(rig: Rig, remote: RobotHandle, sent: list[str]) -> None:
    link = links_of(remote)["r1"]
    move = remote["Arm"].send_cmd("move0.5")
    slow = remote["Gauge"].send_req("slow0.3")
    assert rig.begun("move0.5")
    link.close()
    assert eventually(lambda: not links_of(remote))
    assert slow.get(timeout=WAIT_S) is not None  # asked again, over the engine
    assert move.get(timeout=WAIT_S) == 7
    assert remote["Arm"].send_cmd("step1").get() == 1
    assert sent
    assert rig.never_twice()


def test_a_token_that_is_reported_twice_keeps_the_link(remote: RobotHandle, sent: list[str]) -> None:
    controller, link = controller_of(remote), links_of(remote)["r1"]
    handshakes_s = controller.last_handshake_s
    controller._on_liveliness(keys.alive_key(controller.fleet, "r1"), is_alive=True)
    assert eventually(lambda: controller.last_handshake_s > handshakes_s)
    assert links_of(remote)["r1"] is link
    assert remote["Arm"].send_cmd("step1").get(timeout=WAIT_S) == 1
    assert not sent


@contextmanager
def through(wire: Wire, rig: Rig) -> Iterator[RobotHandle]:
    """Connect through a proxy to a robot that is served at its own port."""
    config = rig.config
    entry = replace(config.robots["r1"], address=f"tcp/127.0.0.1:{wire.port}")
    with RobotService(config, "r1"), ready(Fleet(replace(config, robots={"r1": entry}))) as fleet:
        yield fleet["r1"]


def test_a_proxy_is_not_bypassed(rig: Rig, sent: list[str]) -> None:
    address = rig.config.robots["r1"].address
    assert address is not None
    wire = Wire(int(address.rpartition(":")[2]))
    with through(wire, rig) as robot:
        assert robot["Arm"].send_cmd("step1").get() == 1
        assert not links_of(robot)
        assert sent
    wire.close()


def test_the_fleet_file_can_rule_it_out(tmp_path: Path, sent: list[str]) -> None:
    rig = Rig(tmp_path, network={"shared_memory": False})
    with rig.served_here() as fleet:
        assert fleet["r1"]["Arm"].send_cmd("step1").get() == 1
        assert f"@eal-{PROTOCOL_VERSION}-{process_of(fleet['r1'])}" not in names()
        assert sent


def test_a_fleet_with_certificates_has_none(tmp_path: Path, sent: list[str]) -> None:
    folder = tmp_path / "keys"
    make_authority(folder, "f")
    make_certificate(folder, "r1", ["127.0.0.1"])
    make_certificate(folder, "controller")
    security = {"keys": str(folder), "roles": {"controllers": ["controller"]}}
    rig = Rig(tmp_path, network={"security": security}, protocol="tls")
    with rig.served_here() as fleet:
        assert fleet["r1"]["Arm"].send_cmd("step1").get() == 1
        assert f"@eal-{PROTOCOL_VERSION}-{process_of(fleet['r1'])}" not in names()
        assert sent


@pytest.mark.parametrize(
    "packet", [b"\xc1", b"\x93\xa1x\xc4\x00", b"\x93\x01\xc4\x00\xc4\x00", b"\x92\xa0\xa0", b"\xff" * 65_000]
)
def test_a_malformed_packet_ends_the_link_alone(remote: RobotHandle, packet: bytes) -> None:
    assert links_of(remote)["r1"]._socket.send(packet)
    assert eventually(lambda: not links_of(remote))
    assert remote["Arm"].send_cmd("step1").get(timeout=WAIT_S) == 1


def test_malformed_calls_harm_nobody(remote: RobotHandle) -> None:
    rng = random.Random(5)  # noqa: S311  # not for secrets
    link, key = links_of(remote)["r1"], controller_of(remote).call_key("r1", "Arm", "send_cmd")
    for _ in range(300):
        assert link.send(rng.choice((key, "x", key[:-1])), rng.randbytes(rng.randrange(60)), rng.randbytes(3))

    def works() -> bool:
        with contextlib.suppress(ProtocolError):  # the answer to a malformed call goes to all that wait
            return bool(remote["Arm"].send_cmd("step1").get(timeout=WAIT_S) == 1)
        return False

    assert eventually(works)
    assert links_of(remote)["r1"] is link


def test_who_does_not_greet_keeps_nobody_out(remote: RobotHandle) -> None:
    port = int(remote._actor.address.rpartition(":")[2])  # type: ignore[attr-defined]
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as silent:
        silent.connect(f"\0eal-{PROTOCOL_VERSION}-{process_of(remote)}")
        assert silent.recv(1) == b""  # after a moment it is shown the door
    assert dial(process_of(remote), 1) is None  # there is no link at that port
    links = [dial(process_of(remote), port) for _ in range(20)]
    assert sum(link is not None for link in links) == 15  # and one is in use
    for link in links:
        if link is not None:
            link._socket.close()
    assert remote["Arm"].send_cmd("step1").get() == 1


DIAL = """
import os, sys
from eal_actors.kernel.errors import ProtocolError
from eal_actors.wire.local_link import dial
os.setuid(65534)
print(dial(sys.argv[1], int(sys.argv[2])))
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to be another user")
def test_other_users_get_no_link(remote: RobotHandle) -> None:
    port = remote._actor.address.rpartition(":")[2]  # type: ignore[attr-defined]
    command = [sys.executable, "-c", DIAL, process_of(remote), port]
    done = subprocess.run(command, capture_output=True, text=True, timeout=WAIT_S, check=True)
    assert done.stdout == "None\n"


NO_DESCRIPTORS = """
import os, resource, socket, time
from eal_actors.wire.local_link import LocalListener, _name, dial
early = LocalListener("early", lambda port: True, print)
ends = [socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(2)]
resource.setrlimit(resource.RLIMIT_NOFILE, (64, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
held = []
try:
    while True:
        held.append(os.open(os.devnull, os.O_RDONLY))
except OSError:
    pass
try:
    LocalListener("late", lambda port: True, print)
    raise SystemExit("there was a descriptor")
except OSError:
    pass
assert dial("early", 1) is None
for end in ends:
    end.connect(_name("early"))
    end.send(b"1")
time.sleep(0.2)  # the listener had a descriptor for the first of them alone
for number in held:
    os.close(number)
for end in ends:
    end.settimeout(30)
    assert end.recv(1) == bytes([1])
early.close()
"""
"""A program that may open no socket for a while, as in a restricted service or with all descriptors in use."""


def test_without_sockets_there_is_no_link_and_no_harm() -> None:
    subprocess.run([sys.executable, "-c", NO_DESCRIPTORS], timeout=2 * WAIT_S, check=True)


def test_a_stop_does_not_wait_for_room(rig: Rig, remote: RobotHandle) -> None:
    """The buffer of the link is full: the stop goes over the engine."""
    remote["Arm"].send_cmd("move30")
    assert rig.begun("move30")
    link = links_of(remote)["r1"]
    send = link.send
    link.send = lambda *_: False  # type: ignore[method-assign]
    assert remote["Arm"].halt().get(timeout=WAIT_S) == 1
    link.send = send  # type: ignore[method-assign]
    assert remote["Arm"].send_cmd("step1").get() == 1


def test_what_finds_no_room_in_time_ends_the_link() -> None:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    link = LocalLink(near)
    assert not link.send("key", bytes(70_000), b"")  # too long for it
    while link.send("key", bytes(1000), b""):
        pass
    assert not link.send_patiently("key", b"", b"")
    received = 0
    while far.recv(70_000):
        received += 1
    assert received > 128
    near.close()
    far.close()
