"""Verify a signed update, write it to the inactive slot, and let the boot loader try it once.

An update is a tar of `manifest.json`, its signature (ed25519, 64 bytes), the kernel and the root file system, in this
order. Nothing is written before the signature is verified. The slot is tried only after the written data has been
read back and matches the manifest's hashes. So a power cut at any instant does not affect the running system.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import hashlib
import json
import os
import subprocess
import sys
import tarfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, Final

STATE: Final = Path("/run/evbotos")
BOOT: Final = Path("/boot")
CHOICE: Final = BOOT / "slots.env"
"""The slot state for the boot loader: GRUB's environment block, which U-Boot reads as lines of text."""
KEY: Final = BOOT / "robot/update_key"
"""The public key in 64 hex digits."""
PLATFORM: Final = Path("/etc/evbotos/platform")
_HEADER: Final = "# GRUB Environment Block\n"
_CHUNK: Final = 1 << 20
_ED25519: Final = 1087
"""OpenSSL's identifier of the key type."""


class RefusedError(Exception):
    """The update must not be installed."""


def verify(public_key: bytes, signature: bytes, message: bytes) -> bool:
    """Return whether a signature is valid for a message, using the OpenSSL of Python's `ssl`."""
    crypto = ctypes.CDLL("libcrypto.so.3")
    for name in ("EVP_PKEY_new_raw_public_key", "EVP_MD_CTX_new"):
        getattr(crypto, name).restype = ctypes.c_void_p
    key = crypto.EVP_PKEY_new_raw_public_key(_ED25519, None, public_key, ctypes.c_size_t(len(public_key)))
    context = crypto.EVP_MD_CTX_new()
    if not key or not context:
        raise RefusedError("the key in robot/update_key is not an ed25519 key")
    if crypto.EVP_DigestVerifyInit(ctypes.c_void_p(context), None, None, None, ctypes.c_void_p(key)) != 1:
        raise RefusedError("this OpenSSL does not support ed25519")
    sizes = ctypes.c_size_t(len(signature)), ctypes.c_size_t(len(message))
    return bool(crypto.EVP_DigestVerify(ctypes.c_void_p(context), signature, sizes[0], message, sizes[1]) == 1)


def read_choice() -> dict[str, str]:
    """Return the slot state."""
    lines = CHOICE.read_text().splitlines()
    return dict(line.split("=", 1) for line in lines if "=" in line and not line.startswith("#"))


def write_choice(values: dict[str, str]) -> None:
    """Overwrite the slot state in place: 1024 bytes, two sectors of one cluster."""
    text = _HEADER + "".join(f"{key}={value}\n" for key, value in values.items())
    with writable_boot():
        overwrite(CHOICE, text.ljust(1024, "#").encode())


def overwrite(file: Path, content: bytes) -> None:
    """Overwrite an existing file in place, keeping its size, and sync it to the disk."""
    with file.open("r+b") as target:
        target.write(content)
        target.flush()
        os.fsync(target.fileno())


@contextmanager
def writable_boot() -> Iterator[None]:
    """Make the boot partition writable during a `with` block."""
    _mount("remount,rw")
    try:
        yield
    finally:
        os.sync()
        _mount("remount,ro")


def _mount(options: str) -> None:
    subprocess.run(["mount", "-o", options, BOOT], check=True)


def running_slot() -> str:
    """Return `a` or `b`."""
    slot = (STATE / "slot").read_text().strip()
    if slot not in ("a", "b"):
        raise RefusedError("this system was not started from a slot, so it has no other slot to update")
    return slot


def is_good() -> bool:
    """Return whether the running slot is permanent."""
    return read_choice().get("good") == running_slot()


def mark_good() -> None:
    """Make the running slot permanent and report success to the boot loader."""
    values = read_choice()
    slot = running_slot()
    if values.get("good") != slot or values.get("starts"):
        due = "" if values.get("try") == slot else values.get("try", "")
        write_choice({"good": slot, "try": due, "starts": ""})
        sys.stdout.write(f"slot {slot} is good\n")


def install(stream: IO[bytes]) -> None:
    """Install an update into the other slot; the next boot tries it.

    Raises:
        RefusedError: the update is not trusted, not for this machine, too large, or was not written correctly.
    """
    other = "b" if running_slot() == "a" else "a"
    with tarfile.open(fileobj=stream, mode="r|") as archive:
        members = iter(archive)
        signed = _next(archive, members, "manifest.json").read(_CHUNK)
        signature = _next(archive, members, "manifest.sig").read(64)
        manifest = _trusted(signed, signature)
        if manifest["platform"] != PLATFORM.read_text().strip():
            raise RefusedError(f"it is for {manifest['platform']}, this is {PLATFORM.read_text().strip()}")
        slot = Path((STATE / f"slot-{other}").read_text().strip())
        kernel = BOOT / f"vmlinuz-{other}"
        for part, room in (("kernel", kernel.stat().st_size), ("root", _size_of(slot))):
            if manifest[part]["size"] > room:
                raise RefusedError(f"its {part} has {manifest[part]['size']} bytes, and there is room for {room}")
        with writable_boot():
            _write(_next(archive, members, "kernel"), kernel, manifest["kernel"])
        _write(_next(archive, members, "root"), slot, manifest["root"])
    write_choice({**read_choice(), "try": other})
    sys.stdout.write(f"{manifest['image']} {manifest['version']} is in slot {other}; the next start tries it\n")


def _next(archive: tarfile.TarFile, members: Iterator[tarfile.TarInfo], name: str) -> IO[bytes]:
    member = next(members, None)
    file = archive.extractfile(member) if member is not None and member.name == name else None
    if file is None:
        raise RefusedError(f"it lacks {name} where it should be")
    return file


def _trusted(signed: bytes, signature: bytes) -> dict[str, Any]:
    if not KEY.is_file():
        raise RefusedError("this robot has no key to verify updates with (robot/update_key on the boot partition)")
    if not verify(bytes.fromhex(KEY.read_text().strip()), signature, signed):
        raise RefusedError("its signature is not that of this robot's key")
    manifest: dict[str, Any] = json.loads(signed)
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
                raise RefusedError(f"it ends within {target.name}")
            file.write(chunk)
            left -= len(chunk)
        file.flush()
        os.fsync(file.fileno())
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)  # read from the disk, not the cache
    digest, left = hashlib.sha256(), wanted["size"]
    with target.open("rb") as file:
        while left:
            chunk = file.read(min(left, _CHUNK))
            digest.update(chunk)
            left -= len(chunk)
    if digest.hexdigest() != wanted["sha256"]:
        raise RefusedError(f"what is in {target.name} now is not what was signed; it will not be tried")


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
    except (RefusedError, OSError, tarfile.TarError, subprocess.CalledProcessError) as error:
        sys.stderr.write(f"evbotos-update: refused: {error}\n")
        sys.exit(1)


if __name__ == "__main__":
    main()
