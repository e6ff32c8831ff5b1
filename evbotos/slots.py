"""The slot state: a small file on the boot partition, shared by the boot loader and the system.

`good` is the slot to start, `try` a slot to start once, and `starts` has an `x` for each start since the system
last reported success. The file is a GRUB environment block, which U-Boot reads as lines of text. It keeps its size
and position, so that a write changes only two sectors.
"""

from __future__ import annotations

from typing import Final

from evbotos.errors import BuildError

FILE: Final = "slots.env"
SIZE: Final = 1024
FIRST: Final = {"good": "a", "try": "", "starts": ""}
"""The slot state of a new disk."""
_HEADER: Final = "# GRUB Environment Block\n"


def state_block(values: dict[str, str]) -> bytes:
    """Return the file's content, always 1024 bytes.

    Raises:
        BuildError: the values do not fit.
    """
    text = _HEADER + "".join(f"{key}={value}\n" for key, value in values.items())
    if len(text) > SIZE:
        raise BuildError(f"the slot state exceeds {SIZE} bytes")
    return text.ljust(SIZE, "#").encode("ascii")
