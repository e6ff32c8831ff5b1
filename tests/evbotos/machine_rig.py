"""The update programs of the image with a folder in place of its partitions, and updates signed with a fixed key."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from eal_actors.kernel.clock import REAL_TIME
from evbotos.fields import ROOTFS
from evbotos.slots import state_block
from evbotos.update import write_update
from evbotos.verity import Verity
from tests.evbotos.proof import parse_choice

KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
LONGEST_START_S = 300.0
"""The limit of a robot's start, beside others on a busy computer."""
POWER = "power-cut"
"""The file with the number of bytes of an update after which a machine loses its power."""
OWN = "7.0.0.1700000000"
VERITY = Verity(1, "ab" * 32, "cd" * 16)
PROGRAMS = ROOTFS / "services/update/usr/lib/evbotos"


def comes_true(happens: Callable[[], object]) -> bool:
    """Poll what a machine's start brings about; return whether it happens in time."""
    end_s = REAL_TIME.now() + LONGEST_START_S
    while not happens() and REAL_TIME.now() < end_s:
        REAL_TIME.sleep(0.05)
    return bool(happens())


def program(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return a module of the image."""
    monkeypatch.syspath_prepend(PROGRAMS)
    return importlib.import_module(f"evbotos_update.{name}")


def point_at(folder: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Give the programs a folder in place of partitions, state and description; return their module `installation`."""
    module, state = (program(name, monkeypatch) for name in ("installation", "slot_state"))
    for name, place in (("STATE", ""), ("BOOT", ""), ("ABOUT", ""), ("VERIFIED", "dm-0")):
        monkeypatch.setattr(module, name, folder / place)
    monkeypatch.setattr(module, "KEYS", (folder / "none", folder / "update_key"))
    for name in ("STATE", "BOOT"):
        monkeypatch.setattr(state, name, folder)
    for part in ("install", "serve", "slot_state"):
        monkeypatch.setattr(program(part, monkeypatch), "writable_boot", nullcontext)
    return module


def fill_machine(folder: Path, room: int = 5000) -> None:
    """Make a folder a machine that runs slot a, whose slots have room for so many bytes."""
    (folder / "slot").write_text("a\n")
    for slot in "ab":
        (folder / f"slot-{slot}").write_text(f"{folder}/device-{slot}\n")
        (folder / f"device-{slot}").write_bytes(b"o" * room)
        (folder / f"vmlinuz-{slot}").write_bytes(b"o" * 3000)
        (folder / f"root-{slot}.env").write_bytes(state_block({}))
    (folder / "slots.env").write_bytes(state_block({"good": "a", "try": "", "starts": "x", "floor": ""}))
    (folder / "manifest.json").write_text(json.dumps({"release": OWN}))
    (folder / "update_key").write_text(KEY.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw).hex())
    (folder / "platform").write_text("board\n")


def prepare_machine(folder: Path, monkeypatch: pytest.MonkeyPatch, room: int = 5000) -> None:
    """Make a folder a machine that runs slot a, and give the programs that folder."""
    fill_machine(folder, room)
    point_at(folder, monkeypatch)


def bundle(
    *,
    platform: str = "board",
    key: Ed25519PrivateKey = KEY,
    root: bytes = b"R" * 4000,
    flip_at: int | None = None,
    release: str = OWN,
    verity: Verity = VERITY,
) -> bytes:
    """Return an update as `evbotos slot` makes it; with a byte of its root changed after signing, if told so."""
    with TemporaryDirectory() as name:
        built = Path(name)
        (built / "kernel").write_bytes(b"K" * 2000)
        (built / "root.squashfs").write_bytes(root)
        report = {
            "platform": platform,
            "image": "robot",
            "eal_actors": "7",
            "epoch": 1_700_000_000,
            "release": release,
            "verity": asdict(verity),
        }
        (built / "manifest.json").write_text(json.dumps(report))
        (built / "key.pem").write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
        write_update(built, built / "key.pem", built / "update.tar")
        content = bytearray((built / "update.tar").read_bytes())
    if flip_at is not None:
        content[content.index(root) + flip_at] ^= 1
    return bytes(content)


def hash_of(folder: Path) -> dict[str, str]:
    """Return the variables of the other slot's hash file."""
    return parse_choice((folder / "root-b.env").read_bytes())


def choice(folder: Path) -> dict[str, str]:
    """Return the slot state."""
    return parse_choice((folder / "slots.env").read_bytes())
