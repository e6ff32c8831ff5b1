"""A disk image: boot partition, two root slots, data; made without loop devices, mounts or root privileges.

A board that cannot start from the drive which has room for a system starts from a small one: that has the boot
partition alone, and its kernel takes the root from the other.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from evbotos import grub, slots, u_boot
from evbotos.errors import BuildError
from evbotos.hosttools import tool
from evbotos.model import Layout, Platform
from evbotos.shell import run
from evbotos.verity import Verity

MIB: Final = 1 << 20
START: Final = MIB
"""Of the first partition, in bytes."""
KERNEL_ROOM: Final = 6 * MIB
"""Each slot's kernel has that much on the boot partition, so that an update overwrites it in its place."""
DISK_ID: Final = "45564f53"
BOOT_DRIVE_ID: Final = "45564f54"
"""The signature of a small drive to start from, which is not the main drive."""
DATA_LABEL: Final = "evbot-data"
_DATA_UUID: Final = "45564f53-da7a-4000-8000-000000000004"


@dataclass(frozen=True, slots=True)
class Parts:
    """Where the parts of a disk are, in bytes: offset and size."""

    boot: tuple[int, int]
    slot_a: tuple[int, int]
    slot_b: tuple[int, int]
    data: tuple[int, int]

    @property
    def total(self) -> int:
        """The size of the disk."""
        return sum(self.data)


def parts_of(layout: Layout) -> Parts:
    """Return where the parts of a layout are."""
    offset, places = START, []
    for size in (layout.boot, layout.slot, layout.slot, layout.data):
        places.append((offset, size * MIB))
        offset += size * MIB
    return Parts(*places)


def kernel_line(platform: Platform) -> str:
    """Return the kernel's command line without the root device."""
    console = [f"console={platform.console},115200"] if platform.console is not None else []
    own = ("ro", "rootwait", "init=/usr/lib/evbotos/init", *console, "panic=5", "quiet")
    return " ".join([*own, *platform.kernel_arguments])


@dataclass(frozen=True, slots=True)
class Contents:
    """The contents of a disk.

    Attributes:
        root: the compressed root file system for slot A, with its hash tree.
        verity: what identifies it.
        kernel: the kernel file for both slots, if a loader on the disk starts it.
        board: a folder with the files that the board's ROM loads, for the boot partition, or None.
        grub: a folder with GRUB's images, which are written before the first partition, or None.
        boot_files: a folder that becomes `robot` on the boot partition, or None.
        epoch: the date of every file.
    """

    platform: Platform
    root: Path
    verity: Verity
    kernel: Path
    board: Path | None
    grub: Path | None
    boot_files: Path | None
    epoch: int


def write_disk(out: Path, layout: Layout, contents: Contents) -> None:
    """Write a disk image: slot A holds the root, slot B is empty.

    Raises:
        BuildError: a part does not fit, or a tool failed.
    """
    parts = parts_of(layout)
    _require_room("the root file system", contents.root, parts.slot_a[1], "`layout: {slot: ...}`")
    with out.open("wb") as file:
        file.truncate(parts.total)
    others = ((place, "83", "") for place in (parts.slot_a, parts.slot_b, parts.data))
    _write_table(out, DISK_ID, _boot_entry(parts.boot, contents), *others)
    _write_boot(out, DISK_ID, parts.boot, contents, kernel_line(contents.platform))
    with TemporaryDirectory() as folder:
        _write_at(out, contents.root, parts.slot_a[0])
        _write_at(out, _ext4(parts.data[1], Path(folder), contents.epoch), parts.data[0])


def write_boot_drive(out: Path, layout: Layout, contents: Contents) -> None:
    """Write the image of a small boot drive for a machine whose BIOS cannot read its main drive.

    The boot partition of the small drive is authoritative: kernels, the selected slot and the robot's files.

    Raises:
        BuildError: a part does not fit, or a tool failed.
    """
    boot = parts_of(layout).boot
    with out.open("wb") as file:
        file.truncate(sum(boot))
    _write_table(out, BOOT_DRIVE_ID, _boot_entry(boot, contents))
    _write_boot(out, BOOT_DRIVE_ID, boot, contents, f"{kernel_line(contents.platform)} evbotos.boot={BOOT_DRIVE_ID}")


def _boot_entry(place: tuple[int, int], contents: Contents) -> tuple[tuple[int, int], str, str]:
    """Return the entry of the boot partition. A board's ROM requires the type of FAT, a strict UEFI its own."""
    return place, "ef" if _has_efi(contents) else "c", ", bootable"


def _has_efi(contents: Contents) -> bool:
    return contents.grub is not None and (contents.grub / grub.EFI).is_file()


def _write_boot(out: Path, disk_id: str, place: tuple[int, int], contents: Contents, line: str) -> None:
    """Write the boot partition, and GRUB before it."""
    with TemporaryDirectory() as folder:
        boot = Path(folder) / "boot"
        _fill_boot(boot, contents, line)
        _write_at(out, _fat(boot, disk_id, place[1], Path(folder), contents.epoch), place[0])
    if contents.grub is not None:
        grub.install(out, contents.grub, place[0] // grub.SECTOR)


def _require_room(what: str, path: Path, room: int, remedy: str) -> None:
    if path.stat().st_size > room:
        raise BuildError(f"{what} has {path.stat().st_size / 1e6:.1f} MB, its partition {room / 1e6:.1f} MB: {remedy}")


def _write_table(out: Path, disk_id: str, *parts: tuple[tuple[int, int], str, str]) -> None:
    lines = ["label: dos", f"label-id: 0x{disk_id}", "unit: sectors"]
    for (offset, size), kind, flag in parts:
        lines.append(f"start={offset // grub.SECTOR}, size={size // grub.SECTOR}, type={kind}{flag}")
    run([tool("sfdisk"), "--quiet", "--no-reread", "--no-tell-kernel", out], data="\n".join(lines).encode())


def _fill_boot(boot: Path, contents: Contents, line: str) -> None:
    if contents.board is not None:
        shutil.copytree(contents.board, boot)
    else:
        boot.mkdir()
    if contents.grub is not None and _has_efi(contents):
        (boot / grub.EFI_FOLDER).mkdir(parents=True)
        shutil.copyfile(contents.grub / grub.EFI, boot / grub.EFI_FOLDER / grub.EFI)
    robot = boot / "robot"
    if contents.boot_files is not None:
        shutil.copytree(contents.boot_files, robot)
    else:
        robot.mkdir()
    if contents.platform.loader != "none":
        _fill_slots(boot, contents, line)
    for path in boot.rglob("*"):
        os.utime(path, (contents.epoch, contents.epoch))


def _fill_slots(boot: Path, contents: Contents, line: str) -> None:
    """Lay out the boot files of both slots: kernels, the loader's script and the selected slot."""
    _require_room("the kernel", contents.kernel, KERNEL_ROOM, "another kernel")
    for slot in "ab":
        kernel = boot / f"vmlinuz-{slot}"
        shutil.copyfile(contents.kernel, kernel)
        os.truncate(kernel, KERNEL_ROOM)
    if contents.platform.loader == "grub":
        (boot / "grub").mkdir()
        (boot / "grub/grub.cfg").write_text(grub.menu(line, DISK_ID))
    else:
        text = u_boot.script(contents.platform, line, DISK_ID)
        (boot / u_boot.SCRIPT).write_bytes(u_boot.compile_script(text, contents.epoch))
    (boot / slots.FILE).write_bytes(slots.state_block(slots.FIRST))
    for slot, variables in (("a", contents.verity.hash_file()), ("b", {})):
        (boot / slots.hash_file(slot)).write_bytes(slots.state_block(variables))


def _fat(tree: Path, volume_id: str, size: int, work: Path, epoch: int) -> Path:
    """Return a FAT file system with the files of a folder."""
    out = work / "boot.fat"
    env = {"SOURCE_DATE_EPOCH": str(epoch), "MTOOLS_SKIP_CHECK": "1"}
    with out.open("wb") as file:
        file.truncate(size)
    run([tool("mformat"), "-i", out, "-N", volume_id, "-v", "EVBOT", "-T", str(size // grub.SECTOR), "::"], env=env)
    # Capitals sort first, and the OMAP's ROM requires MLO to be the first file.
    run([tool("mcopy"), "-i", out, "-s", "-m", "-Q", *sorted(tree.iterdir()), "::/"], env=env)
    return out


def _ext4(size: int, work: Path, epoch: int) -> Path:
    """Return an empty ext4 file system without features that need space or a large kernel."""
    out = work / "data.ext4"
    with out.open("wb") as file:
        file.truncate(size)
    env = {"E2FSPROGS_FAKE_TIME": str(epoch), "SOURCE_DATE_EPOCH": str(epoch)}
    extended = f"root_owner=0:0,hash_seed={_DATA_UUID},lazy_itable_init=0,nodiscard"
    options = ["-q", "-t", "ext4", "-L", DATA_LABEL, "-U", _DATA_UUID, "-E", extended, "-m", "0", "-O", "^resize_inode"]
    run([tool("mke2fs"), *options, out], env=env)
    return out


def _write_at(image: Path, part: Path, offset: int) -> None:
    with image.open("r+b") as target, part.open("rb") as source:
        target.seek(offset)
        shutil.copyfileobj(source, target, MIB)
