"""Changes of the other slot by an update, in the only safe order.

`begin` verifies the signature, platform, release and sizes before anything is written. Then it clears an earlier `try`
and the slot's root hash; without a hash, the boot loader does not start the slot. `finish` reads both parts back,
compares them with the manifest, and writes the hash and `try` last. So neither a refused update nor a power cut at any
instant makes a slot start that was not verified.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from . import ed25519, slot_state
from .slot_state import BOOT, STATE, change_choice, hash_file, read_block, read_choice, write_block

KEYS: Final = (BOOT / "robot/update_key", Path("/data/robot/update_key"))
"""Where the public key may be, in 64 hex digits: on the card as it was flashed, or as it was provisioned."""
ABOUT: Final = Path("/etc/evbotos")
VERIFIED: Final = Path("/dev/dm-0")
"""The running root; the kernel verifies each block with dm-verity."""
CHUNK: Final = 1 << 20
_NEW: Final = "new-slot"
"""The file in the state folder that says that the running slot became permanent in this start."""


class RefusedError(Exception):
    """The update must not be installed."""


@dataclass(frozen=True)
class Installation:
    """An update that was verified as far as its manifest.

    Attributes:
        slot: the slot that it is written to.
        manifest: the signed manifest.
        targets: the file or device of each part.
    """

    slot: str
    manifest: dict[str, Any]
    targets: dict[str, Path]


def running_slot() -> str:
    """Return `a` or `b`.

    Raises:
        RefusedError: this system has no slots.
    """
    slot = slot_state.running_slot()
    if slot is None:
        raise RefusedError("this system was not started from a slot, so it has no other slot to update")
    return slot


def other_slot() -> str:
    """Return the slot that is not running.

    Raises:
        RefusedError: this system has no slots.
    """
    return "b" if running_slot() == "a" else "a"


def is_good() -> bool:
    """Return whether the running slot is permanent."""
    return read_choice().get("good") == running_slot()


def mark_good() -> bool:
    """Verify the running root, make its slot permanent, raise the floor, and report success to the boot loader.

    Returns:
        Whether the slot was not permanent before.
    """
    slot, values = running_slot(), read_choice()
    if VERIFIED.exists():
        read_through(VERIFIED, size_of(VERIFIED))  # a changed block stops the kernel here, before it is good
    due = {} if values.get("try") != slot else {"try": ""}
    floor = max(own_release(), values.get("floor", ""), key=_order)
    change_choice(good=slot, starts="", floor=floor, **due)
    is_new = values.get("good") != slot
    if is_new:
        (STATE / _NEW).touch()
    return is_new


def targets_of(slot: str) -> dict[str, Path]:
    """Return the file or device of each part of a slot."""
    return {"kernel": BOOT / f"vmlinuz-{slot}", "root": Path((STATE / f"slot-{slot}").read_text().strip())}


def begin(signed: bytes, signature: bytes) -> Installation:
    """Verify a manifest, and make the other slot unable to start.

    Raises:
        RefusedError: the update is not trusted, not for this machine, too old or too large, or the running slot is not
            good yet.
    """
    other = other_slot()
    if not is_good():
        raise RefusedError("the running slot is not good yet, and the other one may be needed: try again in a minute")
    if not (BOOT / hash_file(other)).is_file():
        raise RefusedError("the boot loader on this card is older than this system and does not verify slots: flash it")
    manifest = trusted(signed, signature)
    targets = targets_of(other)
    _require_fit(manifest, targets)
    change_choice(**{"try": ""})
    write_block(hash_file(other), {})
    return Installation(other, manifest, targets)


def require_part(installation: Installation, part: str) -> None:
    """Read a part back from the disk and compare it with the manifest.

    Raises:
        RefusedError: it differs.
    """
    target, wanted = installation.targets[part], installation.manifest[part]
    if read_through(target, wanted["size"]) != wanted["sha256"]:
        raise RefusedError(f"what is in {target.name} now is not what was signed; it will not be tried")


def finish(installation: Installation) -> str:
    """Let the boot loader try the slot, both parts of which have been read back, and return what it holds."""
    manifest = installation.manifest
    write_block(hash_file(installation.slot), manifest["verity"])
    change_choice(**{"try": installation.slot})
    return f"{manifest['image']} {manifest['version']} is in slot {installation.slot}; the next start tries it"


def fall_back() -> None:
    """Let the boot loader try the other slot again, which was good before the running one.

    Only in the start in which the running slot became permanent: later, nobody but the boot loader may go back to an
    older release.

    Raises:
        RefusedError: the running slot was permanent before this start, or the other one holds no system.
    """
    other = other_slot()
    if not (STATE / _NEW).is_file():
        raise RefusedError("the running slot was good before this start: only a new one falls back")
    if not read_block(hash_file(other)):
        raise RefusedError(f"slot {other} holds no system that may start")
    change_choice(**{"try": other})


def own_release() -> str:
    """Return the release of the running system."""
    return str(json.loads((ABOUT / "manifest.json").read_text())["release"])


def _require_fit(manifest: dict[str, Any], targets: dict[str, Path]) -> None:
    """Check that an update is for this machine, not older than the floor, and not too large."""
    platform = (ABOUT / "platform").read_text().strip()
    if manifest["platform"] != platform:
        raise RefusedError(f"it is for {manifest['platform']}, this is {platform}")
    floor = max(own_release(), read_choice().get("floor", ""), key=_order)
    if _order(manifest["release"]) < _order(floor):
        raise RefusedError(f"its release {manifest['release']} is older than {floor}, which this robot has had")
    for part, target in targets.items():
        room = size_of(target)
        if manifest[part]["size"] > room:
            raise RefusedError(f"its {part} has {manifest[part]['size']} bytes, and there is room for {room}")


def _order(release: str) -> list[int]:
    return [int(number) for number in re.findall(r"\d+", release)]


def trusted(signed: bytes, signature: bytes) -> dict[str, Any]:
    """Return a manifest if its signature is that of this robot's key.

    Raises:
        RefusedError: it is not, or the manifest lacks something.
    """
    key = next((file.read_text().strip() for file in KEYS if file.is_file()), None)
    if key is None:
        raise RefusedError(
            "this robot has no key to verify updates with: local.yaml's update_key, and flash or provision"
        )
    if not ed25519.verify(bytes.fromhex(key), signature, signed):
        raise RefusedError("its signature is not that of this robot's key")
    manifest: dict[str, Any] = json.loads(signed)
    missing = {"platform", "image", "version", "release", "verity", "kernel", "root"} - set(manifest)
    if missing:
        raise RefusedError(f"its manifest lacks {', '.join(sorted(missing))}: sign it with a current `evbotos slot`")
    return manifest


def size_of(device: Path) -> int:
    """Return the size of a file or device."""
    with device.open("rb") as file:
        return file.seek(0, os.SEEK_END)


def read_through(target: Path, size: int) -> str:
    """Read from the disk, not from the cache, and return the hash."""
    digest, left = hashlib.sha256(), size
    with target.open("rb") as file:
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        while left:
            chunk = file.read(min(left, CHUNK))
            if not chunk:
                raise RefusedError(f"{target.name} ends {left} bytes too early")
            digest.update(chunk)
            left -= len(chunk)
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
    return digest.hexdigest()
