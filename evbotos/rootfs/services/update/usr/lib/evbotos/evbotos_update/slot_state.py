"""The files that the boot loader reads: the slot state and the hash files of the slots.

They are GRUB environment blocks of 1024 bytes, which U-Boot reads as lines of text. Each is overwritten in place, so
that a power cut leaves the old content or the new one.
"""

from __future__ import annotations

import fcntl
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

STATE: Final = Path("/run/evbotos")
BOOT: Final = Path("/boot")
_HEADER: Final = "# GRUB Environment Block\n"
_SIZE: Final = 1024
_MOUNT_TIMEOUT_S: Final = 60.0


def read_block(name: str) -> dict[str, str]:
    """Return the variables of a file on the boot partition."""
    lines = (BOOT / name).read_text().splitlines()
    return dict(line.split("=", 1) for line in lines if "=" in line and not line.startswith("#"))


def write_block(name: str, values: dict[str, str]) -> None:
    """Overwrite a file on the boot partition.

    Raises:
        ValueError: the variables do not fit.
    """
    text = _HEADER + "".join(f"{key}={value}\n" for key, value in values.items())
    if len(text) > _SIZE:
        raise ValueError(f"the variables of {name} exceed {_SIZE} bytes")
    with writable_boot(), (BOOT / name).open("r+b") as target:
        target.write(text.ljust(_SIZE, "#").encode())
        target.flush()
        os.fsync(target.fileno())


def read_choice() -> dict[str, str]:
    """Return the slot state: `good`, `try`, `starts` and `floor`."""
    return read_block("slots.env")


def change_choice(**changes: str) -> None:
    """Change variables of the slot state; another program that changes it waits."""
    with locked("choice"):
        values = read_choice()
        if {**values, **changes} != values:
            write_block("slots.env", {**values, **changes})


def hash_file(slot: str) -> str:
    """Return the name of a slot's hash file; a slot starts only if it is not empty."""
    return f"root-{slot}.env"


@contextmanager
def locked(name: str, *, wait: bool = True) -> Iterator[None]:
    """Hold a lock during a `with` block.

    Raises:
        BlockingIOError: another program holds it, and `wait` is false.
    """
    with (STATE / f"{name}.lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield


@contextmanager
def writable_boot() -> Iterator[None]:
    """Make the boot partition writable during a `with` block."""
    with locked("boot"):
        _mount("remount,rw")
        try:
            yield
        finally:
            os.sync()
            _mount("remount,ro")


def _mount(options: str) -> None:
    subprocess.run(["mount", "-o", options, BOOT], check=True, timeout=_MOUNT_TIMEOUT_S)


def running_slot() -> str | None:
    """Return `a` or `b`, or None if this system was not started from a slot."""
    slot = (STATE / "slot").read_text().strip()
    return slot if slot in ("a", "b") else None
