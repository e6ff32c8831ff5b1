"""Real disks of the kernel: loop devices."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from evbotos.block_devices import System, Target
from evbotos.errors import FlashError
from evbotos.flash import BLOCK, Lost, opened, refusals, what_is_on, write_image
from evbotos.flash_command import flash
from tests.evbotos.flash.rig import MIB, MKE2FS, SECTOR, SFDISK, make_image, unheard


@pytest.fixture
def loop(tmp_path: Path) -> Iterator[Callable[[int], Path]]:
    """Return what makes a loop device of a size."""
    losetup = shutil.which("losetup", path="/usr/sbin:/sbin")
    if os.geteuid() != 0 or losetup is None:
        pytest.skip("loop devices need root and losetup")
    made: list[str] = []

    def attach(size: int) -> Path:
        backing = tmp_path / f"backing{len(made)}"
        with backing.open("wb") as file:
            file.truncate(size)
        done = subprocess.run([losetup, "-P", "-f", "--show", backing], capture_output=True, text=True, check=False)
        if done.returncode:
            pytest.skip(f"losetup does not work here: {done.stderr.strip()}")
        made.append(done.stdout.strip())
        return Path(made[-1])

    yield attach
    for name in made:
        subprocess.run([losetup, "-d", name], check=True)


def partition(disk: Path) -> None:
    """Give a disk two partitions, the first with an ext4 named `old robot`."""
    if SFDISK is None or MKE2FS is None:
        pytest.skip("sfdisk or mke2fs is not installed (packages fdisk, e2fsprogs)")
    table = b"label: dos\nstart=2048,size=8192,type=83\nstart=10240,type=c\n"
    subprocess.run([SFDISK, "-q", disk], input=table, check=True)
    options = ["-q", "-F", "-t", "ext4", "-L", "old robot", "-E", f"offset={MIB}", str(disk), "4M"]
    subprocess.run([MKE2FS, *options], check=True, stderr=subprocess.DEVNULL)


def test_a_loop_device_is_shown_written_and_compared(
    tmp_path: Path, loop: Callable[[int], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    image, disk = make_image(tmp_path / "disk.img"), loop(32 * MIB)
    partition(disk)
    assert what_is_on(System().target(disk))[0] == Lost(f"{disk.name}p1", 4 * MIB, "ext4", "old robot")
    flash(image.path, disk, yes=True, not_removable=True, as_json=True)
    said = capsys.readouterr()
    assert "old robot" in said.err
    assert f'"size": {image.size}' in said.out
    assert disk.read_bytes()[: image.size] == image.path.read_bytes()


def test_a_loop_device_that_is_mounted_held_or_too_small_is_refused(
    tmp_path: Path, loop: Callable[[int], Path]
) -> None:
    image, disk, small = make_image(tmp_path / "disk.img"), loop(32 * MIB), loop(MIB)
    assert "it is too small" in refusals(image, System().target(small), may_be_fixed=True)[0]
    if MKE2FS is None:
        pytest.skip("mke2fs is not installed (package e2fsprogs)")
    subprocess.run([MKE2FS, "-q", "-F", disk], check=True, stderr=subprocess.DEVNULL)
    point = tmp_path / "mounted here"
    point.mkdir()
    if subprocess.run(["mount", disk, point], check=False, capture_output=True).returncode:
        pytest.skip("file systems cannot be mounted here")
    try:
        assert refusals(image, System().target(disk), may_be_fixed=True) == [
            f"it is mounted on {point}: umount {point}"
        ]
        free = Target(disk, 32 * MIB, "loop", False, True, ())  # had nothing been noticed, the kernel still refuses
        with pytest.raises(FlashError, match="something uses it"), opened(free):
            pass
    finally:
        subprocess.run(["umount", point], check=True)


def test_the_file_of_a_loop_device_is_refused(tmp_path: Path, loop: Callable[[int], Path]) -> None:
    disk = loop(MIB)
    obstacles = System().target(tmp_path / "backing0").obstacles
    assert obstacles == (f"{disk} uses it: losetup -d {disk}",)


def test_a_disk_that_fails_below_is_told(tmp_path: Path, loop: Callable[[int], Path]) -> None:
    """A device of the kernel's mapper: good sectors, then bad ones."""
    dmsetup = shutil.which("dmsetup", path="/usr/sbin:/sbin")
    if dmsetup is None:
        pytest.skip("dmsetup is not installed")
    image, disk = make_image(tmp_path / "disk.img"), loop(32 * MIB)
    good = 2 * BLOCK // SECTOR
    table = f"0 {good} linear {disk} 0\n{good} {64 * 1024 - good} error\n"
    name = f"evbotos-test-{os.getpid()}"
    made = subprocess.run([dmsetup, "create", name], input=table, capture_output=True, text=True, check=False)
    if made.returncode:
        pytest.skip(f"the kernel's mapper does not work here: {made.stderr.strip()}")
    try:
        mapped = System().target((Path("/dev/mapper") / name).resolve())
        assert "is held by" in System().target(disk).obstacles[0]
        with opened(mapped) as medium, pytest.raises(FlashError, match=f"failed at byte {2 * BLOCK}"):
            write_image(image, medium, unheard)
    finally:
        subprocess.run([dmsetup, "remove", name], check=True)
