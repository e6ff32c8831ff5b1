"""Writing an image to a card or a disk, and making sure that it is on it (Source: thesis A.5).

The first block, where the partition table is, is cleared before all others and written after all others: a card whose
writing was interrupted looks empty, and not like a robot's.
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
"""Bytes that are written, and compared, at a time."""
_TABLE_MARK: Final = b"\x55\xaa"
"""The end of the first sector of every disk with partitions: of an MBR's, and of a GPT's protective one."""
_BLKRRPART: Final = 0x125F
_BLKFLSBUF: Final = 0x1261
_GONE: Final = (errno.ENODEV, errno.ENXIO, errno.ENOMEDIUM)

Phase = Literal["writing", "checking"]
Tell = Callable[[Phase, int], None]
"""Told the phase, and the bytes that are done of it."""


class Medium(Protocol):
    """What takes blocks and gives them back."""

    def write_at(self, data: memoryview, offset: int) -> int:
        """Write some of the data, at least a byte; returns how many bytes. Raises OSError."""
        ...

    def read_at(self, size: int, offset: int) -> bytes:
        """Return up to `size` bytes, none at the end. Raises OSError."""
        ...

    def sync(self) -> None:
        """Return when what was written is on the medium. Raises OSError."""
        ...

    def forget(self) -> None:
        """See that reading from now on asks the medium and not the computer's memory of it."""
        ...


@dataclass(frozen=True, slots=True)
class Lost:
    """Something that is on a disk before it is written.

    Attributes:
        name: partition, or the disk where it has no partitions.
        size: in bytes.
        kind: file system or what else is there, or an empty text.
        label: its name, or an empty text.
    """

    name: str
    size: int
    kind: str
    label: str


@dataclass(frozen=True, slots=True)
class Flashed:
    """A disk that holds an image.

    Attributes:
        size: bytes that were written and compared.
        sha256: of them.
        write_s: real seconds until all was on the medium.
        check_s: real seconds of reading back.
    """

    size: int
    sha256: str
    write_s: float
    check_s: float


def refusals(image: DiskImage, target: Target, may_be_fixed: bool) -> list[str]:
    """Return every reason why an image must not be written to a target; none if it may.

    Args:
        image: what is to be written.
        target: where.
        may_be_fixed: whether the user allows what is not a removable medium.
    """
    reasons = list(target.obstacles)
    if not target.is_removable and not may_be_fixed:
        what = "a fixed disk" if target.is_device else "a file"
        reasons.append(f"it is {what} and not a removable medium: --not-removable if you mean it")
    if target.size < image.size:
        reasons.append(f"it is too small: {target.size} bytes for an image of {image.size}")
    if target.path.exists() and target.path.samefile(image.path):
        reasons.append("it is the image itself")
    return reasons


def what_is_on(target: Target) -> list[Lost]:
    """Return what would be lost, as far as the disk tells: its partitions, or what fills it without any."""
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
    """Return the partitions of a disk as sfdisk tells them, or None if it has none."""
    try:
        with path.open("rb") as disk:
            is_marked = disk.read(SECTOR)[-len(_TABLE_MARK) :] == _TABLE_MARK
    except OSError:  # opening it for writing will tell why
        return None
    if not is_marked:
        return None
    sfdisk = tool("sfdisk")
    try:
        table: dict[str, Any] = json.loads(run([sfdisk, "--json", path], timeout_s=60))["partitiontable"]
    except BuildError:  # the mark is that of a boot sector without partitions
        return None
    return table


def _probe(path: Path, offset: int, size: int) -> tuple[str, str]:
    """Return the file system and the label at a place of a disk."""
    place = ["--offset", str(offset), "--size", str(size)]
    try:
        said = run([tool("blkid"), "--probe", *place, "--output", "export", path], timeout_s=60)
    except BuildError:  # it knows nothing of what is there
        return "", ""
    fields = dict(line.split("=", 1) for line in said.splitlines() if "=" in line)
    return fields.get("TYPE", fields.get("PTTYPE", "")), fields.get("LABEL", "").replace("\\ ", " ")


@contextlib.contextmanager
def opened(target: Target) -> Iterator[Medium]:
    """Open a target for nobody else.

    Raises:
        FlashError: something uses it after all, or it cannot be opened.
    """
    exclusive = os.O_EXCL if target.is_device else 0  # to the kernel: fail if it is mounted anywhere, or held
    try:
        descriptor = os.open(target.path, os.O_RDWR | os.O_CLOEXEC | exclusive)
    except PermissionError:
        raise FlashError(f"{target.path} may not be written by this user: sudo, or the group `disk`") from None
    except OSError as error:
        reason = "something uses it" if error.errno == errno.EBUSY else error.strerror
        raise FlashError(f"{target.path} cannot be opened: {reason}") from None
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)  # which keeps udev from looking into it meanwhile
        except BlockingIOError:
            raise FlashError(f"{target.path} is being written or examined by another program") from None
        yield _OpenMedium(descriptor, target.is_device)
    finally:
        os.close(descriptor)


class _OpenMedium:
    """A medium that is an open device or file."""

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
            with contextlib.suppress(PermissionError):  # who is not root has the advice above alone
                fcntl.ioctl(self._descriptor, _BLKFLSBUF)
            with contextlib.suppress(OSError):  # some disks have no partitions, and then it does not matter
                fcntl.ioctl(self._descriptor, _BLKRRPART)


def write_image(image: DiskImage, medium: Medium, tell: Tell) -> Flashed:
    """Write an image, read it back, and compare.

    Args:
        image: what is written.
        medium: where it is written.
        tell: told how far it is.

    Raises:
        FlashError: the medium did not take it, vanished, or did not keep it; says where.

    Thread: blocks for as long as the medium takes.
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
    """Write all blocks, the first one last; returns the hash of each, and that of the whole."""
    first = _block(file, 0, size)
    _write_block(medium, bytes(len(first)), 0)
    digests, whole = [hashlib.sha256(first).digest()], hashlib.sha256(first)
    done = 0
    for offset in range(BLOCK, size, BLOCK):
        data = _block(file, offset, size)
        digests.append(hashlib.sha256(data).digest())
        whole.update(data)
        _write_block(medium, data, offset)
        _sync(medium, offset)  # or the progress would be that of the computer's memory
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
        raise FlashError(f"the image became shorter while it was read: it ends at byte {offset + len(data)}")
    return data


def _write_block(medium: Medium, data: bytes, offset: int) -> None:
    rest = memoryview(data)
    while rest:
        with _failures_named("writing", offset):
            written = medium.write_at(rest, offset)
        if written <= 0:
            raise FlashError(f"writing stopped at byte {offset}: the medium takes no more")
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
            raise FlashError(f"the medium ends at byte {offset + len(data)}: it is smaller than it says")
        data += part
    return data


def _tell_difference(wanted: bytes, found: bytes, offset: int) -> None:
    first = next((at for at, (one, other) in enumerate(zip(wanted, found, strict=True)) if one != other), None)
    if first is None:
        raise FlashError(f"the image changed between writing and checking, in the block at byte {offset}; flash again")
    wrong = sum(map(operator.ne, wanted, found))
    raise FlashError(
        f"the medium did not keep what was written: byte {offset + first} is {found[first]:#04x} in place of "
        f"{wanted[first]:#04x}, and {wrong} bytes are wrong of the {len(wanted)} from byte {offset} on; "
        "it is worn out, or smaller than it says"
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
        raise FlashError(f"{what} failed at byte {offset}: {reason}; what is on it cannot be used") from error
