"""What boards without GRUB start by, as it lies in the disk image."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from evbotos.board_boot import write_board_boot
from evbotos.definitions import load_definitions
from evbotos.disk import DISK_ID, Contents, parts_of, write_disk
from evbotos.errors import BuildError
from evbotos.hosttools import find_tool
from evbotos.lock import lock_path, read_lock
from evbotos.model import Layout, Platform

TOOLS = ("sfdisk", "mformat", "mcopy", "mdir", "mtype", "mke2fs", "dpkg-deb")
LAYOUT = Layout(boot=16, slot=2, data=4)

pytestmark = pytest.mark.skipif(any(find_tool(name) is None for name in TOOLS), reason="make evbotos-setup")


def package(folder: Path, name: str, files: list[str]) -> Path:
    """Make a Debian package whose files hold their own names."""
    for file in files:
        (folder / name / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / name / file).write_text(file)
    (folder / name / "DEBIAN").mkdir(parents=True)
    control = f"Package: {name}\nVersion: 1\nArchitecture: all\nMaintainer: nobody\nDescription: none\n"
    (folder / name / "DEBIAN/control").write_text(control)
    out = folder / f"{name}.deb"
    subprocess.run(["dpkg-deb", "-b", folder / name, out], check=True, stdout=subprocess.DEVNULL)
    return out


def disk_of(platform: Platform, folder: Path) -> Path:
    """Write a disk for a board, with small files in the place of kernel and root."""
    packages = {name: package(folder, name, list(files)) for name, files in platform.boot_files.items()}
    kernel = folder / "kernel"
    kernel.mkdir()
    for name in (platform.kernel.file, *(Path(tree).name for tree in platform.kernel.device_trees)):
        (kernel / name).write_text(name)
    (folder / "root").write_text("root")
    write_board_boot(platform, packages, kernel, folder / "board")
    contents = Contents(
        root=folder / "root",
        kernel=None,
        board=folder / "board",
        boot_files=None,
        kernel_line="",
        has_grub=False,
        epoch=1_700_000_000,
    )
    write_disk(folder / "disk.img", LAYOUT, contents)
    return folder / "disk.img"


def mtools(program: str, disk: Path, *words: str) -> str:
    place = f"{disk}@@{parts_of(LAYOUT).boot[0]}"
    return subprocess.run([program, "-i", place, *words], capture_output=True, text=True, check=True).stdout


def test_the_beagleboards_rom_finds_its_loader_first(tmp_path: Path) -> None:
    disk = disk_of(load_definitions().platform("beagle-armhf"), tmp_path)
    table = subprocess.run([str(find_tool("sfdisk")), "-d", disk], capture_output=True, text=True, check=True).stdout
    first = next(line for line in table.splitlines() if line.startswith(f"{disk}1"))
    assert "type=c, bootable" in first  # the ROM looks for a FAT there
    names = mtools("mdir", disk, "-b", "::/").split()
    assert names[0] == "::/MLO"
    assert {"::/u-boot.img", "::/vmlinuz", "::/omap3-beagle.dtb"} <= set(names)
    assert mtools("mtype", disk, "::/MLO") == "usr/lib/u-boot/omap3_beagle/MLO"
    menu = mtools("mtype", disk, "::/extlinux/extlinux.conf")
    assert f"append root=PARTUUID={DISK_ID}-02" in menu
    assert "console=ttyS2,115200" in menu
    assert "kernel /vmlinuz\n" in menu


def test_the_raspberry_pis_firmware_finds_all_that_its_settings_name(tmp_path: Path) -> None:
    disk = disk_of(load_definitions().platform("raspberry-pi"), tmp_path)
    names = {name.removeprefix("::/") for name in mtools("mdir", disk, "-b", "::/").split()}
    assert {"bootcode.bin", "cmdline.txt", "bcm2837-rpi-3-b.dtb", "bcm2711-rpi-4-b.dtb"} <= names
    settings = mtools("mtype", disk, "::/config.txt").splitlines()
    named = {line.partition("=")[2] for line in settings if line.startswith(("kernel=", "start_file=", "fixup_file="))}
    assert len(named) == 5
    assert named <= names
    assert f"root=PARTUUID={DISK_ID}-02" in mtools("mtype", disk, "::/cmdline.txt")


def test_a_package_without_its_file_is_told(tmp_path: Path) -> None:
    platform = load_definitions().platform("beagle-armhf")
    empty = package(tmp_path, "u-boot-omap", [])
    with pytest.raises(BuildError, match="u-boot-omap has no file usr/lib/u-boot/omap3_beagle/MLO"):
        write_board_boot(platform, {"u-boot-omap": empty}, tmp_path, tmp_path / "board")


@pytest.mark.parametrize("name", ["beagle-armhf", "raspberry-pi"])
def test_the_lock_pins_the_first_stages(name: str) -> None:
    found = load_definitions()
    platform = found.platform(name)
    lock = read_lock(lock_path(platform, found.image("robot")))
    assert lock is not None
    assert set(platform.boot_files) <= {package.name for package in lock.build_packages}
