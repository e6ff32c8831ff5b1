"""The kernel's description identifies disks that must not be written."""

from __future__ import annotations

from pathlib import Path

import pytest

from evbotos.block_devices import System, Target
from evbotos.errors import FlashError
from evbotos.flash import refusals
from tests.evbotos.flash.rig import SECTOR, a_file, make_image


class FakeKernel:
    """A folder that looks like /sys and /proc of a machine with a few disks."""

    def __init__(self, root: Path) -> None:
        self.root = root
        (root / "proc/self").mkdir(parents=True)
        (root / "sys/block").mkdir(parents=True)
        (root / "sys/dev/block").mkdir(parents=True)
        (root / "proc/swaps").write_text("Filename Type Size Used Priority\n")
        (root / "proc/self/mountinfo").write_text("")
        self._count = 0

    def node(self, where: str, **attributes: object) -> tuple[Path, str]:
        """Add a disk (`sda`) or a partition (`sda/sda1`); returns its folder and number."""
        folder = self.root / "sys/devices" / where
        (folder / "holders").mkdir(parents=True)
        self._count += 1
        number = f"8:{self._count}"
        for name, value in {"dev": number, "ro": 0, "size": 1 << 16, "removable": 1, **attributes}.items():
            file = folder / name.replace("__", "/")
            file.parent.mkdir(exist_ok=True)
            file.write_text(f"{value}\n")
        (self.root / "sys/dev/block" / number).symlink_to(folder)
        return folder, number

    def mount(self, number: str, point: str, source: str = "none") -> None:
        with (self.root / "proc/self/mountinfo").open("a") as file:
            file.write(f"20 1 {number} / {point} rw,relatime shared:1 - ext4 {source} rw\n")

    def target(self, number: str) -> Target:
        return System(self.root).disk(Path("/dev/sda"), number)


@pytest.fixture
def kernel(tmp_path: Path) -> FakeKernel:
    return FakeKernel(tmp_path / "machine")


def test_a_stick_is_free_and_removable(kernel: FakeKernel) -> None:
    _, number = kernel.node("usb1/sda", device__vendor="SanDisk", device__model="Ultra ")
    target = kernel.target(number)
    assert (target.model, target.size, target.is_removable, target.obstacles) == (
        "SanDisk Ultra",
        (1 << 16) * SECTOR,
        True,
        (),
    )


@pytest.mark.parametrize(("kind", "is_removable"), [("SD", True), ("MMC", False)])
def test_a_card_is_removable_and_soldered_flash_is_not(kernel: FakeKernel, kind: str, is_removable: bool) -> None:
    _, number = kernel.node("mmc0/mmcblk0", removable=0, device__type=kind)
    assert kernel.target(number).is_removable is is_removable


def test_a_disk_is_in_use_by_each_of_its_partitions(kernel: FakeKernel) -> None:
    _, disk = kernel.node("sda")
    _, one = kernel.node("sda/sda1", partition=1)
    kernel.node("sda/sda2", partition=2)
    kernel.mount(one, r"/media/my\040stick")
    assert kernel.target(disk).obstacles == ("sda1 on it is mounted on /media/my stick: umount /media/my stick",)


@pytest.mark.parametrize("point", ["/", "/boot", "/home"])
def test_the_systems_disk_is_named_so_through_every_layer(kernel: FakeKernel, point: str) -> None:
    _, disk = kernel.node("sda", removable=0)
    part, _ = kernel.node("sda/sda3", partition=3)
    crypt, _ = kernel.node("virtual/dm-0")
    volume, volume_number = kernel.node("virtual/dm-1")
    (part / "holders/dm-0").symlink_to(crypt)
    (crypt / "holders/dm-1").symlink_to(volume)
    kernel.mount(volume_number, point)
    obstacles = kernel.target(disk).obstacles
    assert f"it is the system's disk: dm-1 on it is mounted on {point}" in obstacles
    assert "sda3 on it is held by dm-0 (a volume, an encrypted disk or a RAID)" in obstacles


def test_write_protection_an_empty_reader_and_a_partition_are_told(kernel: FakeKernel) -> None:
    _, locked = kernel.node("sda", ro=1)
    _, empty = kernel.node("sdb", size=0)
    _, part = kernel.node("sdc/sdc1", partition=1)
    assert "write-protected" in kernel.target(locked).obstacles[0]
    assert "no medium" in kernel.target(empty).obstacles[0]
    with pytest.raises(FlashError, match=r"use /dev/sdc$"):
        kernel.target(part)
    with pytest.raises(FlashError, match="does not know"):
        kernel.target("9:99")


def test_every_reason_is_told_at_once(tmp_path: Path, kernel: FakeKernel) -> None:
    _, disk = kernel.node("sda", removable=0, size=8)
    kernel.mount(disk, "/mnt")
    reasons = refusals(make_image(tmp_path / "disk.img"), kernel.target(disk), may_be_fixed=False)
    assert [reason.split(":")[0] for reason in reasons] == [
        "it is mounted on /mnt",
        "it is a fixed disk and not a removable medium; use --not-removable to allow it",
        "it is too small",
    ]


def test_a_file_is_taken_for_a_disk_only_if_told(tmp_path: Path) -> None:
    image = make_image(tmp_path / "disk.img")
    target = a_file(tmp_path / "card", image.size)
    assert "--not-removable" in refusals(image, target, may_be_fixed=False)[0]
    assert refusals(image, target, may_be_fixed=True) == []
    itself = System().target(image.path)
    assert refusals(image, itself, may_be_fixed=True) == ["it is the image itself"]


@pytest.mark.parametrize(("path", "words"), [("/dev/null", "is not a disk"), ("/dev/sdzz", "there is no /dev/sdzz")])
def test_what_is_no_disk_is_refused(path: str, words: str) -> None:
    with pytest.raises(FlashError, match=words):
        System().target(Path(path))
