"""An image of random bytes, and files that stand for disks."""

from __future__ import annotations

import random
import struct
from pathlib import Path

from evbotos.block_devices import System, Target
from evbotos.disk_image import DiskImage, check_image
from evbotos.flash import BLOCK, Phase
from evbotos.hosttools import find_tool

SFDISK, MKE2FS = find_tool("sfdisk"), find_tool("mke2fs")
SECTOR = 512
MIB = 1 << 20


def make_image(path: Path, size: int = 3 * BLOCK + 5 * SECTOR, seed: int = 7) -> DiskImage:
    """Make a disk image of random bytes with one partition from 1 MiB to its end."""
    data = bytearray(random.Random(seed).randbytes(size))  # noqa: S311  # the same bytes each time
    data[:SECTOR] = bytes(SECTOR)
    struct.pack_into("<B3xB3xII", data, 446, 0x80, 0x83, 2048, size // SECTOR - 2048)
    data[510:512] = b"\x55\xaa"
    path.write_bytes(data)
    return check_image(path)


def a_file(path: Path, size: int) -> Target:
    with path.open("wb") as file:
        file.truncate(size)
    return System().target(path)


def unheard(phase: Phase, done: int) -> None:
    """Take no notice of the progress."""
