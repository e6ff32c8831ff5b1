"""Which slot starts: what the boot loader and the system tell each other, in a small file on the boot partition.

`good` is the slot that starts, `try` one that is to start once, and `starts` has an `x` for each start since the system
last said that it came up. The file is GRUB's environment block, and U-Boot reads it as lines of text. It keeps its size
and its place, so that whoever writes it overwrites two sectors and nothing else.
"""

from __future__ import annotations

from typing import Final

from evbotos.errors import BuildError

FILE: Final = "slots.env"
SIZE: Final = 1024
FIRST: Final = {"good": "a", "try": "", "starts": ""}
"""What a new disk says."""
_HEADER: Final = "# GRUB Environment Block\n"


def state_block(values: dict[str, str]) -> bytes:
    """Return the file's content: 1024 bytes, always.

    Raises:
        BuildError: the values need more.
    """
    text = _HEADER + "".join(f"{key}={value}\n" for key, value in values.items())
    if len(text) > SIZE:
        raise BuildError(f"what boot loader and system tell each other has {SIZE} bytes of room")
    return text.ljust(SIZE, "#").encode("ascii")
