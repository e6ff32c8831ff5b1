"""Small files on the boot partition, shared by the boot loader and the system: the slot state and a hash file per slot.

In the state, `good` is the slot to start, `try` a slot to start once, `starts` has an `x` for each start since the
system last reported success, and `floor` is the lowest release that an update may have. A hash file identifies the
root of its slot; an empty one forbids the slot's start. Each file is a GRUB environment block, which U-Boot reads as
lines of text. It keeps its size and position, so that a write changes only two sectors.
"""

from __future__ import annotations

from typing import Final

from packaging.version import Version

from evbotos.errors import BuildError

FILE: Final = "slots.env"
SIZE: Final = 1024
FIRST: Final = {"good": "a", "try": "", "starts": "", "floor": ""}
"""The slot state of a new disk."""
_HEADER: Final = "# GRUB Environment Block\n"


def hash_file(slot: str) -> str:
    """Return the name of a slot's hash file."""
    return f"root-{slot}.env"


def release_of(version: str, epoch: int) -> str:
    """Return the release of a system: the software's version, then the lock's date. It never falls on a robot."""
    parts = [*Version(version).release, 0, 0][:3]
    return ".".join(str(part) for part in (*parts, epoch))


def state_block(values: dict[str, str]) -> bytes:
    """Return the file's content, always 1024 bytes.

    Raises:
        BuildError: the values do not fit.
    """
    text = _HEADER + "".join(f"{key}={value}\n" for key, value in values.items())
    if len(text) > SIZE:
        raise BuildError(f"the variables exceed {SIZE} bytes")
    return text.ljust(SIZE, "#").encode("ascii")
