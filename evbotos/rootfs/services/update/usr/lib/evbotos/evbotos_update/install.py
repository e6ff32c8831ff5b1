"""Verify a signed update, write it to the other slot, and let the boot loader try it once.

An update is a tar of `manifest.json`, its signature (ed25519, 64 bytes), the kernel and the root file system, in this
order. Nothing is written before the signature, platform, release and sizes are verified. Before the first byte, an
earlier `try` and the slot's root hash are cleared; without a hash, the boot loader does not start the slot. Both are
written after the data has been read back and matches the manifest. So neither a refused update nor a power cut at any
instant makes a slot start that was not verified.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import select
import subprocess
import sys
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, Final

from . import ed25519, slot_state
from .slot_state import BOOT, STATE, change_choice, hash_file, read_choice, writable_boot, write_block

KEYS: Final = (BOOT / "robot/update_key", Path("/data/robot/update_key"))
"""Where the public key may be, in 64 hex digits: on the card as it was flashed, or as it was provisioned."""
ABOUT: Final = Path("/etc/evbotos")
VERIFIED: Final = Path("/dev/dm-0")
"""The running root; the kernel verifies each block with dm-verity."""
_CHUNK: Final = 1 << 20
_SILENCE_S: Final = 60.0
"""The longest time without a byte of an update."""


class RefusedError(Exception):
    """The update must not be installed."""


class Patient:
    """A stream that ends with an error if nothing arrives for a minute."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream

    def read(self, size: int) -> bytes:
        """Return up to `size` bytes."""
        if not select.select([self._stream], [], [], _SILENCE_S)[0]:
            raise RefusedError(f"nothing arrived for {_SILENCE_S:g} s")
        return os.read(self._stream.fileno(), size)


def running_slot() -> str:
    """Return `a` or `b`.

    Raises:
        RefusedError: this system has no slots.
    """
    slot = slot_state.running_slot()
    if slot is None:
        raise RefusedError("this system was not started from a slot, so it has no other slot to update")
    return slot


def is_good() -> bool:
    """Return whether the running slot is permanent."""
    return read_choice().get("good") == running_slot()


def mark_good() -> None:
    """Verify the running root, make its slot permanent, raise the floor, and report success to the boot loader."""
    slot, values = running_slot(), read_choice()
    if VERIFIED.exists():
        _read_through(VERIFIED, _size_of(VERIFIED))  # a changed block stops the kernel here, before it is good
    due = {} if values.get("try") != slot else {"try": ""}
    floor = max(_own_release(), values.get("floor", ""), key=_order)
    change_choice(good=slot, starts="", floor=floor, **due)
    if values.get("good") != slot:
        sys.stdout.write(f"slot {slot} is good\n")


def install(stream: IO[bytes]) -> None:
    """Install an update into the other slot; the next boot tries it.

    Raises:
        RefusedError: the update is not trusted, not for this machine, too old, too large, or was not written correctly;
            or the running slot is not good yet, or another update is being installed.
    """
    other = "b" if running_slot() == "a" else "a"
    try:
        with slot_state.locked("update", wait=False):
            _install(stream, other)
    except BlockingIOError:
        raise RefusedError("another update is being installed") from None


def _install(stream: IO[bytes], other: str) -> None:
    if not is_good():
        raise RefusedError("the running slot is not good yet, and the other one may be needed: try again in a minute")
    if not (BOOT / hash_file(other)).is_file():
        raise RefusedError("the boot loader on this card is older than this system and does not verify slots: flash it")
    with tarfile.open(fileobj=Patient(stream), mode="r|") as archive:  # type: ignore[call-overload]  # it only reads
        members = iter(archive)
        signed = _next(archive, members, "manifest.json").read(_CHUNK)
        signature = _next(archive, members, "manifest.sig").read(64)
        manifest = _trusted(signed, signature)
        slot = Path((STATE / f"slot-{other}").read_text().strip())
        kernel = BOOT / f"vmlinuz-{other}"
        _require_fit(manifest, {"kernel": kernel, "root": slot})
        change_choice(**{"try": ""})
        write_block(hash_file(other), {})
        with writable_boot():
            _write(_next(archive, members, "kernel"), kernel, manifest["kernel"])
        _write(_next(archive, members, "root"), slot, manifest["root"])
    write_block(hash_file(other), manifest["verity"])
    change_choice(**{"try": other})
    sys.stdout.write(f"{manifest['image']} {manifest['version']} is in slot {other}; the next start tries it\n")


def _require_fit(manifest: dict[str, Any], targets: dict[str, Path]) -> None:
    """Check that an update is for this machine, not older than the floor, and not too large."""
    platform = (ABOUT / "platform").read_text().strip()
    if manifest["platform"] != platform:
        raise RefusedError(f"it is for {manifest['platform']}, this is {platform}")
    floor = max(_own_release(), read_choice().get("floor", ""), key=_order)
    if _order(manifest["release"]) < _order(floor):
        raise RefusedError(f"its release {manifest['release']} is older than {floor}, which this robot has had")
    for part, target in targets.items():
        room = _size_of(target)
        if manifest[part]["size"] > room:
            raise RefusedError(f"its {part} has {manifest[part]['size']} bytes, and there is room for {room}")


def _own_release() -> str:
    return str(json.loads((ABOUT / "manifest.json").read_text())["release"])


def _order(release: str) -> list[int]:
    return [int(number) for number in re.findall(r"\d+", release)]


def _next(archive: tarfile.TarFile, members: Iterator[tarfile.TarInfo], name: str) -> IO[bytes]:
    member = next(members, None)
    file = archive.extractfile(member) if member is not None and member.name == name else None
    if file is None:
        raise RefusedError(f"it lacks {name} where it should be")
    return file


def _trusted(signed: bytes, signature: bytes) -> dict[str, Any]:
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


def _size_of(device: Path) -> int:
    with device.open("rb") as file:
        return file.seek(0, os.SEEK_END)


def _write(source: IO[bytes], target: Path, wanted: dict[str, Any]) -> None:
    """Copy to the start of a file or device, read back and compare."""
    left = wanted["size"]
    with target.open("r+b") as file:
        while left:
            chunk = source.read(min(left, _CHUNK))
            if not chunk:
                raise RefusedError(f"it ends within {target.name}; the other slot is empty now")
            file.write(chunk)
            left -= len(chunk)
        file.flush()
        os.fsync(file.fileno())
    if _read_through(target, wanted["size"]) != wanted["sha256"]:
        raise RefusedError(f"what is in {target.name} now is not what was signed; it will not be tried")


def _read_through(target: Path, size: int) -> str:
    """Read from the disk, not from the cache, and return the hash."""
    digest, left = hashlib.sha256(), size
    with target.open("rb") as file:
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        while left:
            chunk = file.read(min(left, _CHUNK))
            if not chunk:
                raise RefusedError(f"{target.name} ends {left} bytes too early")
            digest.update(chunk)
            left -= len(chunk)
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
    return digest.hexdigest()


def show_status() -> None:
    """Print the running slot and the slot state."""
    values = read_choice()
    sys.stdout.write(
        f"running {running_slot()}; good {values.get('good')}; to be tried {values.get('try') or 'none'}\n"
    )


_USAGE: Final = "usage: evbotos-update status | install FILE (- for stdin) | good | is-good\n"


def main() -> None:
    """Run the program."""
    words = sys.argv[1:]
    try:
        if words == ["status"]:
            show_status()
        elif words == ["good"]:
            mark_good()
        elif words == ["is-good"]:
            sys.exit(0 if is_good() else 1)
        elif len(words) == 2 and words[0] == "install":
            if words[1] == "-":
                install(sys.stdin.buffer)
            else:
                with Path(words[1]).open("rb") as file:
                    install(file)
        else:
            sys.stderr.write(_USAGE)
            sys.exit(2)
    except (RefusedError, OSError, ValueError, tarfile.TarError, subprocess.SubprocessError) as error:
        sys.stderr.write(f"evbotos-update: refused: {error}\n")
        sys.exit(1)


if __name__ == "__main__":
    main()
