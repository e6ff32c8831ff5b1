"""Validation of disk images: a partition table whose partitions all lie within the file."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from evbotos.block_devices import SECTOR
from evbotos.errors import FlashError

_SIGNATURE: Final = b"\x55\xaa"
_TABLE_AT: Final = 446
_ENTRY: Final = struct.Struct("<B3xB3xII")
_GPT_TYPE: Final = 0xEE
_GPT: Final = b"EFI PART"
_OTHERS: Final = (
    (0, b"hsqs", "a root file system (squashfs); the disk image is next to it"),
    (0, b"\x1f\x8b", "compressed by gzip: gunzip it first"),
    (0, b"\xfd7zXZ\0", "compressed by xz: unxz it first"),
    (0, b"\x28\xb5\x2f\xfd", "compressed by zstd: unzstd it first"),
    (0, b"PK\x03\x04", "a zip archive: unzip it first"),
    (257, b"ustar", "a tar archive"),
    (0x438, b"\x53\xef", "a file system without a partition table (ext)"),
)
_HEAD: Final = 0x440


@dataclass(frozen=True, slots=True)
class DiskImage:
    """An image that can be written to a disk.

    Attributes:
        path: the file.
        size: in bytes, a multiple of the sector size.
        partitions: the number of partitions.
    """

    path: Path
    size: int
    partitions: int


def check_image(path: Path) -> DiskImage:
    """Check that a file is a disk image.

    Raises:
        FlashError: the file is something else or truncated.
    """
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
        size = path.stat().st_size
    except OSError as error:
        raise FlashError(f"{path} cannot be read: {error.strerror}") from None
    if not path.is_file():
        raise FlashError(f"{path} is not a file")
    for offset, magic, words in _OTHERS:
        if head[offset:].startswith(magic):
            raise FlashError(f"{path} is not a disk image but {words}")
    if head[SECTOR - 2 : SECTOR] != _SIGNATURE:
        raise FlashError(f"{path} is not a disk image: it has no partition table")
    entries = [_ENTRY.unpack_from(head, _TABLE_AT + _ENTRY.size * index) for index in range(4)]
    used = [(kind, start, count) for _, kind, start, count in entries if kind]
    if not used:
        raise FlashError(f"{path} is not a disk image: its partition table is empty")
    _require_whole(path, size, head, used)
    return DiskImage(path, size, len(used))


def _require_whole(path: Path, size: int, head: bytes, used: list[tuple[int, int, int]]) -> None:
    if size % SECTOR:
        raise FlashError(f"{path} is truncated: {size} bytes are not a multiple of {SECTOR}")
    if any(kind == _GPT_TYPE for kind, _, _ in used):  # its only entry names the maximum size of a disk
        if head[SECTOR:].startswith(_GPT):
            (end,) = struct.unpack_from("<Q", head, SECTOR + 32)
            end += 1
        else:
            raise FlashError(f"{path} is not a disk image: its table announces a missing GPT")
    else:
        end = max(start + count for _, start, count in used)
    if end * SECTOR > size:
        raise FlashError(f"{path} is truncated: its partitions end at byte {end * SECTOR}, the file at {size}")
