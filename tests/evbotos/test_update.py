from __future__ import annotations

import ctypes
import importlib.util
import io
import json
import tarfile
from contextlib import nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from evbotos.errors import BuildError, UpdateError
from evbotos.plan import ROOTFS
from evbotos.slot_command import slot
from evbotos.slots import state_block
from evbotos.update import write_update
from tests.evbotos.proof import parse_choice

KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
PUBLIC = KEY.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw)


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
    spec = importlib.util.spec_from_file_location(
        "update_slots", ROOTFS / "services/update/usr/lib/evbotos/update_slots.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    for name in ("STATE", "BOOT"):
        monkeypatch.setattr(module, name, tmp_path)
    monkeypatch.setattr(module, "CHOICE", tmp_path / "slots.env")
    monkeypatch.setattr(module, "KEY", tmp_path / "update_key")
    monkeypatch.setattr(module, "PLATFORM", tmp_path / "platform")
    monkeypatch.setattr(module, "writable_boot", nullcontext)
    (tmp_path / "slot").write_text("a\n")
    (tmp_path / "slot-b").write_text(f"{tmp_path}/device-b\n")
    (tmp_path / "device-b").write_bytes(b"o" * 5000)
    (tmp_path / "vmlinuz-b").write_bytes(b"o" * 3000)
    (tmp_path / "slots.env").write_bytes(state_block({"good": "a", "try": "", "starts": "x"}))
    (tmp_path / "update_key").write_text(PUBLIC.hex())
    (tmp_path / "platform").write_text("board\n")
    return module


def bundle(
    *, platform: str = "board", key: Ed25519PrivateKey = KEY, root: bytes = b"R" * 4000, flip_at: int | None = None
) -> io.BytesIO:
    """Return an update as `evbotos slot` makes it; with a byte of its root changed after signing, if told so."""
    with TemporaryDirectory() as name:
        built = Path(name)
        (built / "kernel").write_bytes(b"K" * 2000)
        (built / "root.squashfs").write_bytes(root)
        report = {"platform": platform, "image": "robot", "eal_actors": "7", "epoch": 1_700_000_000}
        (built / "manifest.json").write_text(json.dumps(report))
        (built / "key.pem").write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
        write_update(built, built / "key.pem", built / "update.tar")
        content = bytearray((built / "update.tar").read_bytes())
    if flip_at is not None:
        content[content.index(root) + flip_at] ^= 1
    return io.BytesIO(bytes(content))


def choice(folder: Path) -> dict[str, str]:
    return parse_choice((folder / "slots.env").read_bytes())


def test_a_signed_update_is_written_and_tried_once(robot: Any, tmp_path: Path) -> None:
    robot.install(bundle())
    assert (tmp_path / "device-b").read_bytes() == b"R" * 4000 + b"o" * 1000
    assert (tmp_path / "vmlinuz-b").read_bytes() == b"K" * 2000 + b"o" * 1000
    assert choice(tmp_path) == {"good": "a", "try": "b", "starts": "x"}


def test_a_good_slot_that_came_up_is_counted_from_nought_again_and_an_update_stays_due(
    robot: Any, tmp_path: Path
) -> None:
    robot.install(bundle())
    robot.mark_good()
    assert choice(tmp_path) == {"good": "a", "try": "b", "starts": ""}


def test_a_slot_is_good_once_the_system_in_it_says_so(robot: Any, tmp_path: Path) -> None:
    robot.install(bundle())
    (tmp_path / "slot").write_text("b\n")
    assert not robot.is_good()
    robot.mark_good()
    assert robot.is_good()
    assert choice(tmp_path) == {"good": "b", "try": "", "starts": ""}


@pytest.mark.parametrize(
    ("update", "told"),
    [
        (lambda: bundle(key=Ed25519PrivateKey.from_private_bytes(bytes(32))), "its signature is not that"),
        (lambda: bundle(platform="other"), "it is for other, this is board"),
        (lambda: bundle(root=b"R" * 5001), "its root has 5001 bytes, and there is room for 5000"),
        (lambda: io.BytesIO(bundle().getvalue()[:512]), "end of data|lacks"),
    ],
)
def test_what_is_refused_by_its_manifest_writes_nothing(robot: Any, tmp_path: Path, update: Any, told: str) -> None:
    with pytest.raises((robot.RefusedError, tarfile.TarError), match=told):
        robot.install(update())
    assert (tmp_path / "device-b").read_bytes() == b"o" * 5000
    assert (tmp_path / "vmlinuz-b").read_bytes() == b"o" * 3000
    assert choice(tmp_path) == {"good": "a", "try": "", "starts": "x"}


def test_a_tampered_root_is_not_tried(robot: Any, tmp_path: Path) -> None:
    with pytest.raises(robot.RefusedError, match="is not what was signed; it will not be tried"):
        robot.install(bundle(flip_at=3999))
    assert choice(tmp_path) == {"good": "a", "try": "", "starts": "x"}


@pytest.mark.parametrize("size", [700, 2000, 4000, 6000, 8000])
def test_an_update_that_ends_too_early_is_not_tried(robot: Any, tmp_path: Path, size: int) -> None:
    with pytest.raises((robot.RefusedError, tarfile.TarError)):
        robot.install(io.BytesIO(bundle().getvalue()[:size]))
    assert choice(tmp_path) == {"good": "a", "try": "", "starts": "x"}


def test_a_robot_without_a_key_takes_no_update(robot: Any, tmp_path: Path) -> None:
    (tmp_path / "update_key").unlink()
    with pytest.raises(robot.RefusedError, match="has no key"):
        robot.install(bundle())


def test_the_same_build_and_key_give_the_same_update() -> None:
    assert bundle().getvalue() == bundle().getvalue()


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
