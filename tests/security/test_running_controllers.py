"""Running programs follow their keys: a renewed certificate and a longer list of revoked names need no restart."""

from __future__ import annotations

import contextlib
import shutil
import socket
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from eal_actors.actors.robot_view import RobotState
from eal_actors.facade.fleet import Fleet
from eal_actors.managers.keys.certificates import certificate_file, key_file, make_certificate, renew_certificate
from eal_actors.managers.keys.key_watch import KeyWatch
from eal_actors.managers.keys.revocation import REVOKED
from tests.net.links import eventually
from tests.net.rig import WAIT_S, Rig, becomes, servers
from tests.security.forging import make_keys, secure_rig
from tests.security.test_revocation import folder_for, invoke, with_keys


class CertificateCollector:
    """Takes the place of a robot, and keeps the certificates of all who connect."""

    def __init__(self, folder: Path) -> None:
        self._context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        self._context.load_cert_chain(certificate_file(folder, "r2"), key_file(folder, "r2"))
        self._context.load_verify_locations(certificate_file(folder, "ca"))
        self._context.verify_mode = ssl.CERT_REQUIRED
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self.seen: set[bytes] = set()

    def run(self) -> None:
        """Collect until the listener is shut down."""
        while True:
            try:
                plain, _ = self._listener.accept()
            except OSError:
                return
            plain.settimeout(WAIT_S)
            with contextlib.suppress(OSError), self._context.wrap_socket(plain, server_side=True) as peer:
                self.seen.add(peer.getpeercert(binary_form=True) or b"")

    def close(self) -> None:
        """Stop to listen."""
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()


@contextmanager
def collector(folder: Path) -> Iterator[CertificateCollector]:
    make_certificate(folder, "r2", ["127.0.0.1"])
    collecting = CertificateCollector(folder)
    thread = threading.Thread(target=collecting.run)
    thread.start()
    try:
        yield collecting
    finally:
        collecting.close()
        thread.join(WAIT_S)


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    return make_keys(tmp_path / "keys")


@pytest.fixture
def rig(tmp_path: Path, keys: Path) -> Rig:
    return secure_rig(tmp_path, keys, 60.0)


@contextmanager
def running(rig: Rig, keys: Path) -> Iterator[tuple[Fleet, Path]]:
    """Run the robot r1 and a controller with a folder of keys of its own, which is yielded."""
    theirs = folder_for("controller", keys, rig.folder / "theirs")
    config = with_keys(rig.config, theirs)
    with servers(rig, "r1"), Fleet(config).connect(["r1"]) as fleet:
        assert becomes(fleet["r1"], RobotState.READY)
        yield fleet, theirs


def test_a_running_controller_uses_its_renewed_certificate_and_its_commands_continue(rig: Rig, keys: Path) -> None:
    with collector(keys) as collecting:
        rig.content["robots"]["r2"] = {"address": f"tls/127.0.0.1:{collecting.port}", "plugins": {}}
        rig.write()
        with running(rig, keys) as (fleet, theirs):
            old = ssl.PEM_cert_to_DER_cert(certificate_file(theirs, "controller").read_text())
            assert eventually(lambda: collecting.seen == {old})
            readings = fleet["r1"]["Gauge"].stream(rate_hz=20.0)
            move = fleet["r1"]["Arm"].send_cmd("move60")
            assert rig.begun("move60")

            renew_certificate(keys, "controller")
            folder_for("controller", keys, theirs)

            new = ssl.PEM_cert_to_DER_cert(certificate_file(theirs, "controller").read_text())
            assert eventually(lambda: new in collecting.seen)
            assert becomes(fleet["r1"], RobotState.READY)
            assert eventually(lambda: fleet["r1"]["Gauge"].get_value().exception(timeout=WAIT_S) is None)
            assert not move.done()
            assert eventually(lambda: [running.command for running in fleet["r1"].running] == ["move60"])
            assert not rig.notes("halt")
            known_s = fleet.clock.now()
            assert any((reading.stamp_s or 0.0) > known_s for reading in readings)  # the stream continues
            readings.close()
            assert fleet["r1"]["Arm"].halt().get(timeout=WAIT_S) == 1


def test_a_running_controller_follows_the_list_of_revoked_robots(rig: Rig, keys: Path) -> None:
    with running(rig, keys) as (fleet, theirs):
        code, output = invoke("keys", "revoke", "r1", "--fleet", str(rig.file))
        assert code == 0, output
        shutil.copy(keys / REVOKED, theirs)
        assert becomes(fleet["r1"], RobotState.LOST)
        assert eventually(lambda: "the keys have changed" in str(fleet["r1"].problems))
        assert fleet["r1"]["Gauge"].get_value().exception(timeout=WAIT_S) is not None


def test_keys_that_cannot_be_used_leave_the_controller_connected(
    rig: Rig, keys: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fitting, fits = list[bool](), KeyWatch._fits

    def note_fits(watch: KeyWatch) -> bool:
        fitting.append(fits(watch))
        return fitting[-1]

    monkeypatch.setattr(KeyWatch, "_fits", note_fits)
    with running(rig, keys) as (fleet, theirs):
        (theirs / REVOKED).write_text("../x\n", encoding="utf-8")
        certificate_file(theirs, "controller").write_text("half of it", encoding="utf-8")
        assert eventually(lambda: fitting)
        assert not any(fitting)
        folder_for("controller", keys, theirs)
        assert eventually(lambda: any(fitting))
        count = len(fitting)
        shutil.copy(key_file(keys, "controller"), theirs)  # a further change, looked at after the former
        assert eventually(lambda: any(fitting[count:]))
        assert fleet["r1"].state is RobotState.READY
        assert fleet["r1"]["Gauge"].get_value().get(timeout=WAIT_S).value == -42
