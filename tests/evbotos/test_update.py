from __future__ import annotations

import ctypes
import hashlib
import importlib
import json
import os
import tarfile
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from evbotos.errors import BuildError, UpdateError
from evbotos.slot_command import slot
from evbotos.slots import state_block
from tests.evbotos.machine_rig import KEY, OWN, VERITY, bundle, choice, hash_of, prepare_machine, program

STATE = "evbotos_update.slot_state"


def _has_openssl() -> bool:
    try:
        ctypes.CDLL("libcrypto.so.3")
    except OSError:
        return False
    return True


pytestmark = pytest.mark.skipif(not _has_openssl(), reason="libcrypto.so.3 is not installed")


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The program of the image, with folders in place of its partitions."""
    prepare_machine(tmp_path, monkeypatch)
    return program("install", monkeypatch)


def install(robot: Any, update: bytes) -> None:
    """Install an update that comes through a pipe, as by SSH."""
    path = robot.installation.STATE / "update.tar"
    path.write_bytes(update)
    with path.open("rb") as stream:
        robot.install(stream)


def test_a_signed_update_is_written_and_tried_once(robot: Any, tmp_path: Path) -> None:
    install(robot, bundle())
    assert (tmp_path / "device-b").read_bytes() == b"R" * 4000 + b"o" * 1000
    assert (tmp_path / "vmlinuz-b").read_bytes() == b"K" * 2000 + b"o" * 1000
    assert choice(tmp_path) == {"good": "a", "try": "b", "starts": "x", "floor": ""}
    assert hash_of(tmp_path) == VERITY.hash_file()


def test_a_good_slot_that_came_up_is_counted_from_nought_again_and_an_update_stays_due(
    robot: Any, tmp_path: Path
) -> None:
    install(robot, bundle())
    robot.installation.mark_good()
    assert choice(tmp_path) == {"good": "a", "try": "b", "starts": "", "floor": OWN}


def test_a_slot_is_good_once_the_system_in_it_says_so(robot: Any, tmp_path: Path) -> None:
    install(robot, bundle())
    (tmp_path / "slot").write_text("b\n")
    assert not robot.installation.is_good()
    robot.installation.mark_good()
    assert robot.installation.is_good()
    assert choice(tmp_path) == {"good": "b", "try": "", "starts": "", "floor": OWN}


@pytest.mark.parametrize(
    ("update", "told"),
    [
        (lambda: bundle(key=Ed25519PrivateKey.from_private_bytes(bytes(32))), "its signature is not that"),
        (lambda: bundle(platform="other"), "it is for other, this is board"),
        (lambda: bundle(root=b"R" * 5001), "its root has 5001 bytes, and there is room for 5000"),
        (lambda: bundle(release="7.0.0.1699999999"), r"its release 7\.0\.0\.1699999999 is older than 7\.0\.0\.17"),
        (lambda: bundle(release="6.10.0.1800000000"), "is older than"),
        (lambda: bundle()[:512], "end of data|lacks"),
    ],
)
def test_what_is_refused_by_its_manifest_writes_nothing(robot: Any, tmp_path: Path, update: Any, told: str) -> None:
    with pytest.raises((robot.RefusedError, tarfile.TarError), match=told):
        install(robot, update())
    assert (tmp_path / "device-b").read_bytes() == b"o" * 5000
    assert (tmp_path / "vmlinuz-b").read_bytes() == b"o" * 3000
    assert choice(tmp_path) == {"good": "a", "try": "", "starts": "x", "floor": ""}


def test_the_floor_rises_when_a_slot_is_good_and_never_falls(robot: Any, tmp_path: Path) -> None:
    newer = "7.1.0.1700000001"
    (tmp_path / "manifest.json").write_text(json.dumps({"release": newer}))
    robot.installation.mark_good()
    (tmp_path / "manifest.json").write_text(json.dumps({"release": OWN}))  # the older slot starts again
    robot.installation.mark_good()
    assert choice(tmp_path)["floor"] == newer
    with pytest.raises(robot.RefusedError, match=f"{OWN} is older than {newer}"):
        install(robot, bundle())


@pytest.mark.parametrize("place", ["kernel", "root"])
def test_a_tampered_update_is_not_tried_and_withdraws_the_good_one_before_it(
    robot: Any, tmp_path: Path, place: str
) -> None:
    install(robot, bundle())
    tampered = bytearray(bundle())
    tampered[tampered.index(b"K" * 2000 if place == "kernel" else b"R" * 4000)] ^= 1
    with pytest.raises(robot.RefusedError, match="is not what was signed; it will not be tried"):
        install(robot, bytes(tampered))
    assert choice(tmp_path)["try"] == ""
    assert hash_of(tmp_path) == {}  # the boot loader does not start it


@pytest.mark.parametrize("size", [1300, 2100, 4000, 6000, 8000])
@pytest.mark.parametrize("after_a_good_one", [False, True])
def test_an_update_that_ends_too_early_is_not_tried(
    robot: Any, tmp_path: Path, size: int, after_a_good_one: bool
) -> None:
    if after_a_good_one:
        install(robot, bundle())
    with pytest.raises((robot.RefusedError, tarfile.TarError)):
        install(robot, bundle()[:size])
    assert choice(tmp_path)["try"] == ("b" if after_a_good_one and size < 1600 else "")
    assert hash_of(tmp_path) == (VERITY.hash_file() if after_a_good_one and size < 1600 else {})


def test_an_update_that_stalls_is_refused(robot: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot, "_SILENCE_S", 0.01)
    read, write = os.pipe()
    with os.fdopen(read, "rb") as stream, os.fdopen(write, "wb") as sender:
        sender.write(bundle()[:3000])
        sender.flush()
        with pytest.raises(robot.RefusedError, match=r"nothing arrived for 0\.01 s"):
            robot.install(stream)


def test_a_system_on_trial_takes_no_update_for_the_slot_that_it_may_need(robot: Any, tmp_path: Path) -> None:
    (tmp_path / "slots.env").write_bytes(state_block({"good": "b", "try": "", "starts": "", "floor": ""}))
    with pytest.raises(robot.RefusedError, match="the running slot is not good yet"):
        install(robot, bundle())


def test_only_one_update_is_installed_at_a_time(robot: Any) -> None:
    state = importlib.import_module(STATE)
    with state.locked("update"), pytest.raises(robot.RefusedError, match="another update is being installed"):
        install(robot, bundle())


def test_a_changed_root_is_read_to_its_end_before_it_is_good(robot: Any, tmp_path: Path) -> None:
    (tmp_path / "dm-0").write_bytes(b"R" * 3_000_000)
    assert robot.installation.read_through(tmp_path / "dm-0", 3_000_000) == hashlib.sha256(b"R" * 3_000_000).hexdigest()
    with pytest.raises(robot.RefusedError, match="dm-0 ends 1 bytes too early"):
        robot.installation.read_through(tmp_path / "dm-0", 3_000_001)


def test_a_robot_without_a_key_takes_no_update(robot: Any, tmp_path: Path) -> None:
    (tmp_path / "update_key").unlink()
    with pytest.raises(robot.RefusedError, match="has no key"):
        install(robot, bundle())
    (tmp_path / "update_key").write_text("ab")
    with pytest.raises(ValueError, match="an ed25519 key has 32 bytes, not 1"):
        install(robot, bundle())


def test_a_manifest_of_an_older_tool_is_refused(robot: Any) -> None:
    signed = json.dumps({"platform": "board"}).encode()
    with pytest.raises(robot.RefusedError, match="its manifest lacks image, kernel, release, root, verity, version"):
        robot.installation.trusted(signed, KEY.sign(signed))


def test_the_same_build_and_key_give_the_same_update() -> None:
    assert bundle() == bundle()


def test_a_key_that_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BuildError, match="evbotos build board robot"):
        slot("board", key=tmp_path / "key", output=tmp_path)
    built = tmp_path / "board-robot"
    built.mkdir()
    (built / "manifest.json").write_text("{}")
    with pytest.raises(UpdateError, match="No such file"):
        slot("board", key=tmp_path / "key", output=tmp_path)
    (tmp_path / "key").write_text("-----BEGIN PRIVATE KEY-----\n")
    with pytest.raises(UpdateError, match="openssl genpkey -algorithm ed25519"):
        slot("board", key=tmp_path / "key", output=tmp_path)
