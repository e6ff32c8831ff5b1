"""The kernel's description of a disk: size, removability and users."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from evbotos.errors import FlashError

SECTOR: Final = 512
"""The kernel's unit of sizes, independent of the disk's sectors."""
_ESCAPE: Final = re.compile(r"\\([0-7]{3})")
_SYSTEM: Final = ("/", "/boot", "/boot/efi", "/usr", "/var", "/etc", "/home")
"""Mount points that make a disk a system disk."""


@dataclass(frozen=True, slots=True)
class Target:
    """The target of an image.

    Attributes:
        path: the user's path.
        size: in bytes.
        model: the manufacturer's description, or a description of the file.
        is_removable: whether it is a removable medium: a card or a stick.
        is_device: False for a regular file.
        obstacles: reasons that forbid writing, regardless of options.
    """

    path: Path
    size: int
    model: str
    is_removable: bool
    is_device: bool
    obstacles: tuple[str, ...]


class System:
    """The kernel's view of its disks.

    Args:
        root: the parent folder of `proc` and `sys`.
    """

    def __init__(self, root: Path = Path("/")) -> None:
        self._sys = root / "sys"
        self._proc = root / "proc"

    def target(self, path: Path) -> Target:
        """Return the description of a device or a regular file.

        Raises:
            FlashError: it is neither, or it is a partition.
        """
        try:
            found = path.stat()
        except FileNotFoundError:
            raise FlashError(f"there is no {path}; `lsblk` lists the disks") from None
        except OSError as error:
            raise FlashError(f"{path}: {error.strerror}") from None
        if stat.S_ISREG(found.st_mode):
            return Target(path, found.st_size, "a file", False, False, tuple(self._uses_of_file(path.resolve())))
        if not stat.S_ISBLK(found.st_mode):
            raise FlashError(f"{path} is not a disk")
        return self.disk(path, f"{os.major(found.st_rdev)}:{os.minor(found.st_rdev)}")

    def disk(self, path: Path, number: str) -> Target:
        """Return the description of a disk.

        Args:
            path: its device file.
            number: the kernel's `major:minor`.

        Raises:
            FlashError: the kernel does not know it, or it is a partition.
        """
        node = (self._sys / "dev/block" / number).resolve()
        if not node.is_dir():
            raise FlashError(f"the kernel does not know {path} ({number})")
        if (node / "partition").exists():
            raise FlashError(f"{path} is a partition, but the image is a whole disk; use /dev/{node.parent.name}")
        obstacles = list(self._uses_of_disk(node))
        if _text(node / "ro") == "1":
            obstacles.append("it is write-protected (a card may have a switch for that)")
        size = int(_text(node / "size") or "0") * SECTOR
        if not size:
            obstacles.append("there is no medium in it")
        words = (_text(node / "device" / name) for name in ("vendor", "model", "name"))
        model = " ".join(word for word in words if word) or node.name
        return Target(path, size, model, _can_be_pulled_out(node), True, tuple(obstacles))

    def _uses_of_disk(self, disk: Path) -> Iterator[str]:
        mounts, swaps = self._mounts(), self._swaps()
        for node in self._upon(disk):
            number, name = _text(node / "dev"), node.name
            where = "it" if node == disk else f"{name} on it"
            for point in mounts.get(number, []):
                if point in _SYSTEM:
                    yield f"it is the system's disk: {where} is mounted on {point}"
                else:
                    yield f"{where} is mounted on {point}: umount {point}"
            if number in swaps:
                yield f"{where} is swap space of this system: swapoff /dev/{name}"
            for holder in _names(node / "holders"):
                yield f"{where} is held by {holder} (a volume, an encrypted disk or a RAID)"

    def _upon(self, disk: Path) -> Iterator[Path]:
        """Yield a disk, its partitions, and the devices built on them."""
        nodes = [disk, *(disk / name for name in _names(disk) if (disk / name / "partition").exists())]
        seen: set[Path] = set()
        while nodes:
            node = nodes.pop(0)
            if node in seen:
                continue
            seen.add(node)
            yield node
            nodes += [(node / "holders" / name).resolve() for name in _names(node / "holders")]

    def _uses_of_file(self, path: Path) -> Iterator[str]:
        for loop in sorted((self._sys / "block").glob("loop*")):
            if _text(loop / "loop/backing_file") == str(path):
                yield f"/dev/{loop.name} uses it: losetup -d /dev/{loop.name}"
        if str(path) in self._swap_files():
            yield "it is swap space of this system"

    def _mounts(self) -> dict[str, list[str]]:
        """Return the mount points of each device by number, including devices that a file system names by path only."""
        found: dict[str, list[str]] = {}
        for line in _text(self._proc / "self/mountinfo").splitlines():
            before, _, after = line.partition(" - ")
            fields, rest = before.split(), after.split()
            point = _unescaped(fields[4])
            numbers = {fields[2]}
            if len(rest) > 1 and rest[1].startswith("/dev/"):
                numbers.add(_number_of(Path(_unescaped(rest[1]))))
            for number in numbers - {""}:
                found.setdefault(number, []).append(point)
        return found

    def _swaps(self) -> set[str]:
        return {_number_of(Path(name)) for name in self._swap_files()} - {""}

    def _swap_files(self) -> list[str]:
        lines = _text(self._proc / "swaps").splitlines()[1:]
        return [_unescaped(line.split()[0]) for line in lines if line]


def _can_be_pulled_out(node: Path) -> bool:
    """Return whether a disk is removable: an SD card in a built-in slot is, a USB hard disk is not."""
    return _text(node / "removable") == "1" or _text(node / "device/type") == "SD"


def _number_of(path: Path) -> str:
    try:
        found = path.stat()
    except OSError:
        return ""
    return f"{os.major(found.st_rdev)}:{os.minor(found.st_rdev)}" if stat.S_ISBLK(found.st_mode) else ""


def _names(folder: Path) -> list[str]:
    try:
        return sorted(entry.name for entry in folder.iterdir())
    except OSError:
        return []


def _text(path: Path) -> str:
    try:
        return path.read_text(errors="replace").strip()
    except OSError:
        return ""


def _unescaped(text: str) -> str:
    return _ESCAPE.sub(lambda match: chr(int(match[1], 8)), text)
