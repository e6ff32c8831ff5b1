"""Peers that TLS must refuse: expired certificates, false names, and peers without TLS.

`tests/net/test_tls.py` has who may do what, and the impostors of other authorities, without certificates and at other
addresses; here is the rest, over the whole stack.
"""

from __future__ import annotations

import socket
import ssl
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.facade.service import RobotService
from eal_actors.kernel.clock import wall_time
from eal_actors.kernel.errors import UnavailableError
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.keys import certificates
from eal_actors.managers.keys.certificates import make_authority, make_certificate
from eal_actors.wire.session import controller_config, open_session, robot_config
from tests.net.links import answering, ask, eventually, fleet_of, free_port

TLS_ALERTS = (ssl.SSLError, ConnectionError)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The folder of a fleet file, with good keys."""
    make_authority(tmp_path / "keys", "f")
    for name, hosts in (("r1", ["127.0.0.1"]), ("controller", [])):
        make_certificate(tmp_path / "keys", name, hosts)
    return tmp_path


def tls_fleet(folder: Path, address: str | None = None) -> FleetConfig:
    network = {"security": {"roles": {"controllers": ["controller"]}}}
    return fleet_of(network, {"r1": address or f"tls/127.0.0.1:{free_port()}"}, folder)


@contextmanager
def expired(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Have every certificate that is made meanwhile end yesterday."""
    with monkeypatch.context() as patch:
        patch.setattr(certificates, "wall_time", lambda: wall_time() - certificates.VALID - timedelta(days=1))
        yield


@pytest.mark.parametrize("late", ["r1", "controller"])
def test_a_certificate_that_has_expired_opens_nothing(folder: Path, late: str, monkeypatch: pytest.MonkeyPatch) -> None:
    fleet = tls_fleet(folder)
    with (
        open_session(robot_config(fleet, "r1")) as robot,
        answering(robot, "r1"),
        open_session(controller_config(fleet)) as controller,
    ):
        assert eventually(lambda: ask(controller, "eal/f/r1/_/ping", "controller") == ["r1"])
    with expired(monkeypatch):
        make_certificate(folder / "keys", late, ["127.0.0.1"] if late == "r1" else [], force=True)
    fleet, asked = tls_fleet(folder), list[str]()

    with (
        open_session(robot_config(fleet, "r1")) as robot,
        answering(robot, "r1", asked),
        open_session(controller_config(fleet)) as controller,
    ):
        for _ in range(3):
            assert ask(controller, "eal/f/r1/_/ping", "controller") == []
            assert list(controller.info.peers_zid()) == []
        assert asked == []


@dataclass
class Secure:
    """A robot that serves over TLS, and the fleet of its controllers."""

    config: FleetConfig
    keys: Path
    port: int


@pytest.fixture
def secure(folder: Path) -> Iterator[Secure]:
    port = free_port()
    config = tls_fleet(folder, f"tls/127.0.0.1:{port}")
    with RobotService(config, "r1"):
        yield Secure(config, folder / "keys", port)


def obeys(secure: Secure) -> bool:
    """Return whether the robot still obeys its controller."""
    with Fleet(secure.config) as fleet:
        fleet["r1"].require_started()
        return fleet["r1"]["SampleResource"].set_value(3).get() == 1


def test_who_speaks_no_tls_is_not_answered(secure: Secure) -> None:
    for said in (
        b"GET / HTTP/1.1\r\nHost: r1\r\n\r\n",
        b"\x00\x04\x01\x02\x03\x04",
        b"\x16\x03\x01\xff\xff" + b"\0" * 99,
    ):
        with socket.create_connection(("127.0.0.1", secure.port), 20.0) as peer:
            peer.sendall(said)
            peer.shutdown(socket.SHUT_WR)
            try:
                answer = peer.recv(1000)
            except ConnectionError:
                answer = b""
        assert answer == b"" or answer[0] == 0x15, answer  # a TLS alert
    assert obeys(secure)


def test_a_controller_without_tls_reaches_nothing(secure: Secure) -> None:
    plain = EALConfigManager.of(
        {"version": 1, "name": "f", "robots": {"r1": {"address": f"tcp/127.0.0.1:{secure.port}"}}}
    ).fleet

    with Fleet(plain) as fleet, pytest.raises(UnavailableError, match="does not answer"):
        fleet["r1"]["SampleResource"].set_value(3)

    assert obeys(secure)


def test_a_controller_learns_that_its_certificate_has_expired(secure: Secure, monkeypatch: pytest.MonkeyPatch) -> None:
    with expired(monkeypatch):
        make_certificate(secure.keys, "controller", force=True)

    renew = r"; the certificate controller has expired \(.*\): eal keys renew controller"
    with Fleet(secure.config) as fleet, pytest.raises(UnavailableError, match=renew):
        fleet["r1"]["SampleResource"].set_value(3)


@pytest.mark.parametrize("version", [ssl.TLSVersion.TLSv1, ssl.TLSVersion.TLSv1_1])
@pytest.mark.filterwarnings("ignore:ssl.TLSVersion:DeprecationWarning")
def test_old_versions_of_tls_are_refused(secure: Secure, version: ssl.TLSVersion) -> None:
    context = client(secure)
    context.minimum_version = context.maximum_version = version
    context.set_ciphers("ALL:@SECLEVEL=0")

    with pytest.raises(TLS_ALERTS):
        shake_hands(secure, context)


def test_a_client_without_a_certificate_is_refused(secure: Secure) -> None:
    """In TLS 1.3 a client hears of it at its first reading."""
    assert shake_hands(secure, client(secure)) == b""
    context = ssl.create_default_context(cafile=secure.keys / "ca.pem")

    with pytest.raises(TLS_ALERTS, match=r"CERTIFICATE_REQUIRED|certificate required|reset"):
        shake_hands(secure, context)


def test_a_client_of_another_authority_is_refused(secure: Secure, tmp_path: Path) -> None:
    make_authority(tmp_path / "other", "f")
    make_certificate(tmp_path / "other", "controller")
    context = ssl.create_default_context(cafile=secure.keys / "ca.pem")
    context.load_cert_chain(tmp_path / "other" / "controller.pem", tmp_path / "other" / "controller.key")

    with pytest.raises(TLS_ALERTS):
        shake_hands(secure, context)


def test_the_robots_certificate_is_of_its_own_name_alone(secure: Secure) -> None:
    with pytest.raises(ssl.SSLCertVerificationError, match=r"mismatch|not valid for"):
        shake_hands(secure, client(secure), name="r2.example")


def client(secure: Secure) -> ssl.SSLContext:
    context = ssl.create_default_context(cafile=secure.keys / "ca.pem")
    context.load_cert_chain(secure.keys / "controller.pem", secure.keys / "controller.key")
    return context


def shake_hands(secure: Secure, context: ssl.SSLContext, name: str = "127.0.0.1") -> bytes:
    """Open a TLS connection and read what comes until the peer is silent; nothing, from one that waits for a hello."""
    with (
        socket.create_connection(("127.0.0.1", secure.port), 20.0) as plain,
        context.wrap_socket(plain, server_hostname=name) as peer,
    ):
        peer.settimeout(1.0)
        try:
            return peer.recv(1)
        except TimeoutError:
            return b""


def test_without_verification_of_names_a_thief_would_be_believed(folder: Path) -> None:
    """The proof that the wrong name is what the refusal is about: the same ends, with that check alone left out."""
    make_certificate(folder / "keys", "r1", ["10.99.0.1"], force=True)
    fleet = tls_fleet(folder)
    careless = controller_config(fleet)
    careless["transport"]["link"]["tls"]["verify_name_on_connect"] = False

    with (
        open_session(robot_config(fleet, "r1")) as robot,
        answering(robot, "r1"),
        open_session(controller_config(fleet)) as careful,
        open_session(careless) as other,
    ):
        assert eventually(lambda: ask(other, "eal/f/r1/_/ping", "controller") == ["r1"])
        assert ask(careful, "eal/f/r1/_/ping", "controller") == []
