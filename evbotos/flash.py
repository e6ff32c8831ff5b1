"""Writing an image to a card or disk, with verification (Source: thesis A.5).

The first block holds the partition table. It is cleared before all others and written after all others: a card whose
writing was interrupted looks empty, not like a valid image.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import json
import operator
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final, Literal, Protocol

from eal_actors.kernel.clock import REAL_TIME
from evbotos.block_devices import SECTOR, Target
from evbotos.disk_image import DiskImage
from evbotos.errors import BuildError, FlashError
from evbotos.hosttools import tool
from evbotos.shell import run

BLOCK: Final = 1 << 22
"""Bytes per write and comparison."""
_TABLE_MARK: Final = b"\x55\xaa"
"""The end of the first sector of every partitioned disk: of an MBR and of a GPT's protective MBR."""
_BLKRRPART: Final = 0x125F
_BLKFLSBUF: Final = 0x1261
_GONE: Final = (errno.ENODEV, errno.ENXIO, errno.ENOMEDIUM)

Phase = Literal["writing", "checking"]
Tell = Callable[[Phase, int], None]
"""Receives the phase and its finished bytes."""


class Medium(Protocol):
    """A storage medium for blocks."""

    def write_at(self, data: memoryview, offset: int) -> int:
        """Write at least one byte of the data; return the number of bytes written. Raises OSError."""
        ...

    def read_at(self, size: int, offset: int) -> bytes:
        """Return up to `size` bytes, or no bytes at the end. Raises OSError."""
        ...

    def sync(self) -> None:
        """Block until the written data is on the medium. Raises OSError."""
        ...

    def forget(self) -> None:
        """Discard the page cache, so that later reads come from the medium."""
        ...


@dataclass(frozen=True, slots=True)
class Lost:
    """Existing data that writing destroys.

    Attributes:
        name: the partition, or the disk if it has no partitions.
        size: in bytes.
        kind: the file system or other content; empty if unknown.
        label: its label; may be empty.
    """

    name: str
    size: int
    kind: str
    label: str


@dataclass(frozen=True, slots=True)
class Flashed:
    """A disk with a verified image.

    Attributes:
        size: bytes written and compared.
        sha256: the hash of these bytes.
        write_s: real seconds of writing.
        check_s: real seconds of verification.
    """

    size: int
    sha256: str
    write_s: float
    check_s: float


def refusals(image: DiskImage, target: Target, may_be_fixed: bool) -> list[str]:
    """Return every reason against writing an image to a target.

    Args:
        image: the image.
        target: the target.
        may_be_fixed: whether the user allows a fixed disk.
    """
    reasons = list(target.obstacles)
    if not target.is_removable and not may_be_fixed:
        what = "a fixed disk" if target.is_device else "a file"
        reasons.append(f"it is {what} and not a removable medium; use --not-removable to allow it")
    if target.size < image.size:
        reasons.append(f"it is too small: {target.size} bytes for an image of {image.size}")
    if target.path.exists() and target.path.samefile(image.path):
        reasons.append("it is the image itself")
    return reasons


def what_is_on(target: Target) -> list[Lost]:
    """Return the data that writing destroys: the disk's partitions, or its unpartitioned content."""
    table = _partition_table(target.path)
    if table is None:
        kind, label = _probe(target.path, 0, target.size)
        return [Lost(str(target.path), target.size, kind, label)] if kind else []
    sector = table.get("sectorsize", SECTOR)
    found = []
    for part in table.get("partitions", ()):
        size = part["size"] * sector
        kind, label = _probe(target.path, part["start"] * sector, size)
        found.append(Lost(Path(part["node"]).name, size, kind, label or part.get("name", "")))
    return found


def _partition_table(path: Path) -> dict[str, Any] | None:
    """Return the partitions of a disk as reported by sfdisk, or None without a partition table."""
    try:
        with path.open("rb") as disk:
            is_marked = disk.read(SECTOR)[-len(_TABLE_MARK) :] == _TABLE_MARK
    except OSError:  # opening it for writing reports the reason
        return None
    if not is_marked:
        return None
    sfdisk = tool("sfdisk")
    try:
        table: dict[str, Any] = json.loads(run([sfdisk, "--json", path], timeout_s=60))["partitiontable"]
    except BuildError:  # a boot sector without partitions has the same signature
        return None
    return table


def _probe(path: Path, offset: int, size: int) -> tuple[str, str]:
    """Return the file system and label at an offset of a disk."""
    place = ["--offset", str(offset), "--size", str(size)]
    try:
        said = run([tool("blkid"), "--probe", *place, "--output", "export", path], timeout_s=60)
    except BuildError:  # unknown content
        return "", ""
    fields = dict(line.split("=", 1) for line in said.splitlines() if "=" in line)
    return fields.get("TYPE", fields.get("PTTYPE", "")), fields.get("LABEL", "").replace("\\ ", " ")


@contextlib.contextmanager
def opened(target: Target) -> Iterator[Medium]:
    """Open a target exclusively.

    Raises:
        FlashError: it is in use, or it cannot be opened.
    """
    exclusive = os.O_EXCL if target.is_device else 0  # fails if the device is mounted or held
    try:
        descriptor = os.open(target.path, os.O_RDWR | os.O_CLOEXEC | exclusive)
    except PermissionError:
        raise FlashError(f"{target.path} is not writable by this user; use sudo or join the group `disk`") from None
    except OSError as error:
        reason = "something uses it" if error.errno == errno.EBUSY else error.strerror
        raise FlashError(f"{target.path} cannot be opened: {reason}") from None
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)  # keeps udev from probing the device
        except BlockingIOError:
            raise FlashError(f"{target.path} is being written or examined by another program") from None
        yield _OpenMedium(descriptor, target.is_device)
    finally:
        os.close(descriptor)


class _OpenMedium:
    """An open device or file."""

    def __init__(self, descriptor: int, is_device: bool) -> None:
        self._descriptor = descriptor
        self._is_device = is_device

    def write_at(self, data: memoryview, offset: int) -> int:
        return os.pwrite(self._descriptor, data, offset)

    def read_at(self, size: int, offset: int) -> bytes:
        return os.pread(self._descriptor, size, offset)

    def sync(self) -> None:
        os.fsync(self._descriptor)

    def forget(self) -> None:
        os.posix_fadvise(self._descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
        if self._is_device:
            with contextlib.suppress(PermissionError):  # without root, only the posix_fadvise above applies
                fcntl.ioctl(self._descriptor, _BLKFLSBUF)
            with contextlib.suppress(OSError):  # harmless for disks without partitions
                fcntl.ioctl(self._descriptor, _BLKRRPART)


def write_image(image: DiskImage, medium: Medium, tell: Tell) -> Flashed:
    """Write an image, read it back and compare.

    Args:
        image: the image.
        medium: the target medium.
        tell: receives the progress.

    Raises:
        FlashError: the medium failed, vanished or did not keep the data; names the position.

    Thread: blocks until the medium is done.
    """
    start_s = REAL_TIME.now()
    with image.path.open("rb") as file:
        digests, whole = _write(file, image.size, medium, tell)
        write_s = REAL_TIME.now() - start_s
        with _failures_named("reading back", 0):
            medium.forget()
        _compare(file, image.size, medium, digests, tell)
    return Flashed(image.size, whole, write_s, REAL_TIME.now() - start_s - write_s)


def _write(file: BinaryIO, size: int, medium: Medium, tell: Tell) -> tuple[list[bytes], str]:
    """Write all blocks, the first one last; return the hash of each block and of the whole."""
    first = _block(file, 0, size)
    _write_block(medium, bytes(len(first)), 0)
    digests, whole = [hashlib.sha256(first).digest()], hashlib.sha256(first)
    done = 0
    for offset in range(BLOCK, size, BLOCK):
        data = _block(file, offset, size)
        digests.append(hashlib.sha256(data).digest())
        whole.update(data)
        _write_block(medium, data, offset)
        _sync(medium, offset)  # otherwise the progress would show the page cache
        done += len(data)
        tell("writing", done)
    _write_block(medium, first, 0)
    _sync(medium, 0)
    tell("writing", size)
    return digests, whole.hexdigest()


def _block(file: BinaryIO, offset: int, size: int) -> bytes:
    file.seek(offset)
    wanted = min(BLOCK, size - offset)
    data = file.read(wanted)
    if len(data) != wanted:
        raise FlashError(f"the image was truncated during reading: it ends at byte {offset + len(data)}")
    return data


def _write_block(medium: Medium, data: bytes, offset: int) -> None:
    rest = memoryview(data)
    while rest:
        with _failures_named("writing", offset):
            written = medium.write_at(rest, offset)
        if written <= 0:
            raise FlashError(f"writing stopped at byte {offset}: the medium is full")
        rest, offset = rest[written:], offset + written


def _sync(medium: Medium, offset: int) -> None:
    with _failures_named("writing", offset):
        medium.sync()


def _compare(file: BinaryIO, size: int, medium: Medium, digests: list[bytes], tell: Tell) -> None:
    for index, digest in enumerate(digests):
        offset = index * BLOCK
        found = _read_block(medium, min(BLOCK, size - offset), offset)
        if hashlib.sha256(found).digest() != digest:
            _tell_difference(_block(file, offset, size), found, offset)
        tell("checking", offset + len(found))


def _read_block(medium: Medium, size: int, offset: int) -> bytes:
    data = b""
    while len(data) < size:
        with _failures_named("reading back", offset + len(data)):
            part = medium.read_at(size - len(data), offset + len(data))
        if not part:
            raise FlashError(f"the medium ends at byte {offset + len(data)}: it is smaller than it reports")
        data += part
    return data


def _tell_difference(wanted: bytes, found: bytes, offset: int) -> None:
    first = next((at for at, (one, other) in enumerate(zip(wanted, found, strict=True)) if one != other), None)
    if first is None:
        raise FlashError(f"the image changed between writing and checking, in the block at byte {offset}; flash again")
    wrong = sum(map(operator.ne, wanted, found))
    raise FlashError(
        f"the medium did not keep the written data: byte {offset + first} is {found[first]:#04x} in place of "
        f"{wanted[first]:#04x}, and {wrong} of {len(wanted)} bytes from byte {offset} are wrong; "
        "it is worn out or smaller than it reports"
    )


@contextlib.contextmanager
def _failures_named(what: str, offset: int) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno in _GONE:
            reason = "the device has vanished"
        elif error.errno == errno.ENOSPC:
            reason = "it is full"
        else:
            reason = error.strerror or str(error)
        raise FlashError(f"{what} failed at byte {offset}: {reason}; its content is unusable") from error
