"""A raw zenoh client with a real certificate, which sends anything in anybody's name, and random forgeries."""

from __future__ import annotations

import queue
import random
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import zenoh

from eal_actors.device.data import EALData
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.keys.certificates import make_authority, make_certificate
from eal_actors.wire.format import keys
from eal_actors.wire.format.keys import client_id
from eal_actors.wire.format.messages import (
    Answer,
    CallHeader,
    Heartbeat,
    RobotTime,
    decode_reply,
    encode_call,
    encode_heartbeat,
)
from eal_actors.wire.format.packing import PROTOCOL_VERSION
from eal_actors.wire.format.parts import split
from eal_actors.wire.session import controller_config, open_session
from tests.net.links import eventually
from tests.net.rig import WAIT_S, Rig

ROLES = {
    "controllers": ["controller", {"name": "driver", "resources": ["Eye"]}, {"name": "mate", "resources": ["Arm"]}],
    "observers": ["display"],
}


def make_keys(folder: Path) -> Path:
    """Make the keys of a robot and its controllers."""
    make_authority(folder, "f")
    make_certificate(folder, "r1", ["127.0.0.1"])
    for name in ("controller", "driver", "mate", "display"):
        make_certificate(folder, name)
    return folder


def secure_rig(folder: Path, keys_folder: Path, dead_man_s: float) -> Rig:
    """Return a fleet of one robot with keys."""
    security = {"keys": str(keys_folder), "roles": ROLES}
    rig = Rig(folder, network={"security": security, "dead_man_s": dead_man_s}, protocol="tls")
    rig.content["robots"]["r1"]["exclusive"] = ["Arm", "Eye"]
    rig.write()
    return rig


def as_seen_by(fleet: FleetConfig, name: str) -> FleetConfig:
    """Return the fleet as seen by a controller with the certificate of that name."""
    assert fleet.network.security is not None
    security = replace(fleet.network.security, controller=name)
    return replace(fleet, network=replace(fleet.network, security=security))


class RawClient:
    """A controller made by hand.

    Args:
        session: linked to the robot.
        name: of its certificate.

    Attributes:
        secret: the client in its keys.
        id: its identifier.
    """

    def __init__(self, session: zenoh.Session, name: str) -> None:
        self.session = session
        self.name = name
        self.secret = secrets.token_hex(16)
        self.id = client_id(name, self.secret)
        self.epoch = 1
        self.sequence = 0
        self._heard: queue.SimpleQueue[tuple[bytes, bytes]] = queue.SimpleQueue()
        handler = zenoh.handlers.Callback(self._hear, indirect=False)
        session.declare_subscriber(f"eal/f/@answers/{name}/{self.secret}/r1", handler)
        assert eventually(lambda: list(session.liveliness().get(keys.alive_key("f", "r1"))))
        self.time = RobotTime("", 0.0)

    def _hear(self, answer: zenoh.Sample) -> None:
        assert answer.attachment is not None
        self._heard.put((answer.attachment.to_bytes(), answer.payload.to_bytes()))

    @property
    def heard_nothing(self) -> bool:
        """Whether no reply waits that `call` has not taken."""
        return self._heard.empty()

    def call(self, resource: str, method: str, *arguments: str | int, data: EALData | None = None) -> Answer:
        """Call a method as an honest controller does, and return the answer."""
        self.sequence += 1
        time = self.time
        header = CallHeader(self.id, self.epoch, self.sequence, 60.0, 60.0, None, arguments, time.era, time.time_s, 0.0)
        envelope, payload = encode_call(header, data)
        for head, content in split(envelope, payload):
            self.put(resource, method, head, payload=bytes(content))
        return self.answer_to(self.sequence)

    def answer_to(self, number: int) -> Answer:
        """Wait for the answer to the call of a number, and return it."""
        while True:
            reply = decode_reply(*self._heard.get(timeout=WAIT_S))
            if reply.time is not None:
                self.time = reply.time
            if reply.sequence == number:
                return reply.answer

    def ping(self) -> dict[str, Any]:
        """Return the robot's answer to a ping, which comes after everything that was sent before."""
        answer = self.call(keys.ROBOT, keys.PING)
        assert isinstance(answer, dict), answer
        return answer

    def put(
        self,
        resource: str,
        method: str,
        envelope: bytes,
        name: str | None = None,
        client: str | None = None,
        payload: bytes = b"",
    ) -> None:
        """Send a call in anybody's name."""
        key = f"eal/f/r1/{resource}/{method}/{name or self.name}/{client or self.secret}"
        self.publish(key, payload, envelope)

    def beat(self, name: str | None = None, client: str | None = None, claimed: str | None = None) -> None:
        """Send a heartbeat in anybody's name."""
        beat = encode_heartbeat(Heartbeat(claimed or self.id, "x"))
        self.publish(f"eal/f/@heartbeats/{name or self.name}/{client or self.secret}", beat)

    def publish(self, key: str, payload: bytes, envelope: bytes | None = None) -> None:
        """Publish anything."""
        self.session.put(key, payload, attachment=envelope, congestion_control=zenoh.CongestionControl.BLOCK)


@contextmanager
def raw_client(fleet: FleetConfig, name: str) -> Iterator[RawClient]:
    """Link a raw client with a certificate to the robot; its own access control hinders it in nothing."""
    config = controller_config(as_seen_by(fleet, name))
    del config["access_control"]
    with open_session(config) as session:
        yield RawClient(session, name)


class Target(NamedTuple):
    """The target of a forger, which knows all of this."""

    name: str
    secret: str
    id: str
    epoch: int
    sequence: int


@dataclass
class Forger:
    """Sends random forgeries about a target, none of which its own certificate permits."""

    client: RawClient
    target: Target
    chance: random.Random

    def forge(self) -> str:
        """Send one forgery, and return what it was."""
        kind = self.chance.choice((self._call, self._call, self._call, self._heartbeat, self._publication))
        return kind()

    def _identity(self) -> tuple[str, str, str]:
        """Return the name and the client of a key, and the id in the message; not all three its own."""
        mine, theirs = self.client, self.target
        while True:
            name = self.chance.choice(
                (mine.name, theirs.name, "r1", "_", "controller", "driver", keys.AUTHORITY_CALLER)
            )
            client = self.chance.choice((mine.secret, theirs.secret, theirs.id, secrets.token_hex(16)))
            claimed = self.chance.choice((mine.id, theirs.id, client_id(name, client)))
            if (name, claimed) != (mine.name, client_id(mine.name, client)):
                return name, client, claimed

    def _header(self, claimed: str, arguments: tuple[str | int, ...]) -> CallHeader:
        chance, time = self.chance, self.client.time
        epoch = chance.choice((0, self.target.epoch, self.target.epoch + 1, 999, 10**6, 2**63))
        sequence = chance.choice((1, self.target.sequence, self.target.sequence + 1, 10**6, 2**63))
        ttl_s = chance.choice((1.0, 60.0, 1e300, float("inf")))
        return CallHeader(claimed, epoch, sequence, ttl_s, ttl_s, None, arguments, time.era, time.time_s, 0.0)

    def _call(self) -> str:
        name, client, claimed = self._identity()
        resource, method, arguments = self.chance.choice(
            (
                (keys.ROBOT, keys.HELLO, ("mallory",)),
                (keys.ROBOT, keys.LEAVE, ()),
                (keys.ROBOT, keys.RELEASE, ("Arm", "Eye")),
                (keys.ROBOT, keys.CANCEL, (self.target.epoch, self.target.sequence)),
                (keys.ROBOT, keys.REATTACH, (self.target.epoch, self.target.sequence)),
                (keys.ROBOT, keys.STOP, ("forged",)),
                (keys.ROBOT, keys.RESUME, ()),
                (keys.ROBOT, keys.REVOKE, ("controller",)),
                ("Arm", "send_cmd", ("step9",)),
                ("Arm", "send_cmd", ("s",)),
                ("Arm", "halt", ()),
                ("Arm", "set_config", ("speed",)),
                ("Eye", "send_cmd", ("step9",)),
                ("Eye", "halt", ()),
                ("Gauge", keys.STREAM, ("raw", "5", 0)),
            )
        )
        self.client.put(resource, method, encode_call(self._header(claimed, arguments))[0], name, client)
        return f"{resource}/{method}{arguments} as {name}/{client}, claiming {claimed}"

    def _heartbeat(self) -> str:
        name, client, claimed = self._identity()
        self.client.beat(name, client, claimed)
        return f"heartbeat as {name}/{client}, claiming {claimed}"

    def _publication(self) -> str:
        key = self.chance.choice(
            (
                f"eal/f/@answers/{self.target.name}/{self.target.secret}/r1",
                "eal/f/@events/r1",
                "eal/f/@streams/r1/Gauge/raw/5",
                f"eal/f/@heartbeats/{self.target.name}",
                f"eal/f/r1/Arm/halt/{self.target.name}",
                f"eal/f/r1/Arm/h%61lt/{self.client.name}/{self.target.secret}",
                "eal/f/**",
                "eal/*/r1/*/halt/*/*",
                f"eal/f/@alive/{PROTOCOL_VERSION}/r1",
            )
        )
        self.client.publish(key, encode_heartbeat(Heartbeat(self.target.id, "mallory")), b"\x93\x03\x01\x00")
        return f"publication on {key}"
