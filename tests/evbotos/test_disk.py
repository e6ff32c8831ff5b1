from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from evbotos import grub
from evbotos.apt_sources import sources_for
from evbotos.definitions import load_definitions
from evbotos.disk import BOOT_DRIVE_ID, DISK_ID, KERNEL_ROOM, MIB, Contents, parts_of, write_boot_drive, write_disk
from evbotos.disk_image import check_image
from evbotos.errors import BuildError
from evbotos.hosttools import find_tool
from evbotos.lock import lock_path, read_lock
from evbotos.model import Layout
from evbotos.packages import Apt
from evbotos.slots import release_of, state_block
from evbotos.verity import Verity, append_hashes, read_verity

VERITY = Verity(1, "ab" * 32, "cd" * 16)
LAYOUT = Layout(boot=16, slot=2, data=3)
TOOLS = ("sfdisk", "mformat", "mcopy", "mke2fs")
MISSING = [name for name in TOOLS if find_tool(name) is None]
needs_tools = pytest.mark.skipif(bool(MISSING), reason=f"not installed: {', '.join(MISSING)} (make evbotos-setup)")


def grub_images(folder: Path, core_size: int = 1000, *, has_efi: bool = True) -> Path:
    """Make a folder with files in the place of GRUB's images."""
    images = folder / "grub-images"
    images.mkdir(exist_ok=True)
    (images / "boot.img").write_bytes(b"B" * 512)
    (images / "core.img").write_bytes(b"C" * core_size)
    (images / grub.EFI).unlink(missing_ok=True)
    if has_efi:
        (images / grub.EFI).write_bytes(b"E" * 500)
    return images


def contents(tmp_path: Path, root_size: int = 1000) -> Contents:
    (tmp_path / "root").write_bytes(b"R" * root_size)
    (tmp_path / "kernel").write_bytes(b"K" * 1000)
    robot = tmp_path / "robot"
    robot.mkdir(exist_ok=True)
    (robot / "fleet.yaml").write_text("version: 1\n")
    platform = load_definitions().platform("qemu-amd64")
    images = grub_images(tmp_path)
    return Contents(platform, tmp_path / "root", VERITY, tmp_path / "kernel", None, images, robot, 1_700_000_000)


def test_the_parts_follow_one_another() -> None:
    parts = parts_of(LAYOUT)
    assert parts.boot == (MIB, 16 * MIB)
    assert parts.slot_a == (17 * MIB, 2 * MIB)
    assert parts.slot_b == (19 * MIB, 2 * MIB)
    assert parts.total == 24 * MIB


def test_the_shipped_layout_of_a_robot_is_128_mib() -> None:
    assert parts_of(Layout()).total == 128 * MIB  # a power of two, as a card is


@needs_tools
def test_a_disk_has_its_parts_where_its_table_says(tmp_path: Path) -> None:
    out = tmp_path / "disk.img"
    write_disk(out, LAYOUT, contents(tmp_path))
    sfdisk = find_tool("sfdisk")
    assert sfdisk is not None
    table = json.loads(subprocess.run([sfdisk, "--json", out], capture_output=True, check=True).stdout)
    found = table["partitiontable"]
    assert found["id"] == f"0x{DISK_ID}"
    assert [(part["start"] * 512, part["size"] * 512) for part in found["partitions"]] == [
        (MIB, 16 * MIB),
        (17 * MIB, 2 * MIB),
        (19 * MIB, 2 * MIB),
        (21 * MIB, 3 * MIB),
    ]
    disk = out.read_bytes()
    assert disk[17 * MIB : 17 * MIB + 1001] == b"R" * 1000 + b"\0"
    assert disk[21 * MIB + 1024 + 56 : 21 * MIB + 1024 + 58] == b"\x53\xef"  # ext4's mark
    listed = subprocess.run(
        ["mdir", "-b", "-/", "-i", f"{out}@@{MIB}", "::"], capture_output=True, check=True, text=True
    ).stdout.split()
    assert {
        "::/vmlinuz-a",
        "::/vmlinuz-b",
        "::/grub/grub.cfg",
        "::/slots.env",
        "::/root-a.env",
        "::/root-b.env",
        "::/robot/fleet.yaml",
        "::/EFI/BOOT/BOOTX64.EFI",
    } <= set(listed)
    assert [part["type"] for part in found["partitions"]] == ["ef", "83", "83", "83"]


@needs_tools
def test_a_disk_without_a_program_for_uefi_has_the_type_that_roms_require(tmp_path: Path) -> None:
    what = contents(tmp_path)
    grub_images(tmp_path, has_efi=False)
    write_disk(tmp_path / "disk.img", LAYOUT, what)
    assert (tmp_path / "disk.img").read_bytes()[446 + 4] == 0x0C


@needs_tools
def test_a_small_drive_starts_the_main_drives_system_and_says_which_drive_it_is(tmp_path: Path) -> None:
    out = tmp_path / "boot.img"
    write_boot_drive(out, LAYOUT, contents(tmp_path))
    assert out.stat().st_size == 17 * MIB
    table = check_image(out)
    assert table.partitions == 1
    menu = subprocess.run(
        ["mtype", "-i", f"{out}@@{MIB}", "::/grub/grub.cfg"], capture_output=True, check=True, text=True
    ).stdout
    assert f"dm-mod.waitfor=PARTUUID={DISK_ID}-$part " in menu
    assert f" evbotos.boot={BOOT_DRIVE_ID} evbotos.slot=$slot" in menu


@needs_tools
def test_two_disks_of_the_same_contents_are_the_same_bytes(tmp_path: Path) -> None:
    for write in (write_disk, write_boot_drive):
        for name in ("one", "two"):
            write(tmp_path / name, LAYOUT, contents(tmp_path))
        assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


@needs_tools
def test_what_does_not_fit_is_refused_with_a_remedy(tmp_path: Path) -> None:
    with pytest.raises(BuildError, match=r"the root file system has 3\.1 MB, its partition 2\.1 MB: `layout: \{slot"):
        write_disk(tmp_path / "disk", LAYOUT, contents(tmp_path, 3 * MIB))
    big = contents(tmp_path)
    (tmp_path / "kernel").write_bytes(bytes(KERNEL_ROOM + 1))
    with pytest.raises(BuildError, match="the kernel has"):
        write_disk(tmp_path / "disk", LAYOUT, big)


@pytest.mark.skipif(find_tool("veritysetup") is None, reason="not installed: veritysetup (make evbotos-setup)")
def test_the_root_has_a_hash_tree_that_finds_a_changed_byte(tmp_path: Path) -> None:
    (tmp_path / "squashed").write_bytes(bytes(range(256)) * 100)
    for name in ("one", "two"):
        append_hashes(tmp_path / "squashed", tmp_path / name)
    root, identity = tmp_path / "one/root.squashfs", read_verity(tmp_path / "one")
    assert root.read_bytes() == (tmp_path / "two/root.squashfs").read_bytes()
    assert identity.sectors == 56  # 25,600 bytes are seven blocks
    assert identity.table.split()[:4] == ["4096", "4096", "7", "8"]
    check = [
        str(find_tool("veritysetup")),
        "verify",
        str(root),
        str(root),
        identity.root_hash,
        f"--hash-offset={7 * 4096}",
    ]
    assert subprocess.run(check, check=False).returncode == 0
    with root.open("r+b") as file:
        file.seek(20_000)
        file.write(b"x")
    assert subprocess.run(check, check=False, capture_output=True).returncode != 0


def test_releases_are_ordered_by_version_then_date() -> None:
    assert release_of("1.2", 1_700_000_000) == "1.2.0.1700000000"
    assert release_of("0.10.3.dev1", 5) == "0.10.3.5"


def test_the_choice_of_the_slot_is_always_as_large() -> None:
    block = state_block({"good": "a", "try": ""})
    assert len(block) == 1024
    assert block.startswith(b"# GRUB Environment Block\ngood=a\ntry=\n###")
    with pytest.raises(BuildError, match="1024 bytes"):
        state_block({"a": "x" * 1024})


def test_grub_leaves_the_partition_table_and_the_first_partition_alone(tmp_path: Path) -> None:
    image = tmp_path / "disk"
    image.write_bytes(b"\xee" * 4 * 512 * 8)
    grub.install(image, grub_images(tmp_path), first_partition=8)
    disk = image.read_bytes()
    assert disk[440:512] == b"\xee" * 72
    assert disk[8 * 512 :] == b"\xee" * (len(disk) - 8 * 512)
    with pytest.raises(BuildError, match="GRUB needs"):
        grub.install(image, grub_images(tmp_path, 512 * 8), first_partition=8)


@pytest.mark.skipif(find_tool("grub-mkimage") is None, reason="not installed: grub-mkimage (make evbotos-setup)")
def test_the_locked_grub_is_made_of_its_package_alone_and_has_room(tmp_path: Path) -> None:
    found = load_definitions()
    platform = found.platform("qemu-amd64")
    lock = read_lock(lock_path(platform, found.image("robot")))
    assert lock is not None
    locked = [package for package in lock.build_packages if package.name in platform.disk_packages]
    apt = Apt(tmp_path / "apt", platform.architecture, sources_for(platform.suite, None), pytest.fail)
    try:
        files = apt.fetch(locked, tmp_path / "debs")
    except BuildError as error:
        pytest.skip(f"the package cannot be had here: {error}")
    packages = {package.name: file for package, file in zip(locked, files, strict=True)}
    for name in ("one", "two"):
        grub.write_images(packages, tmp_path / name)
        (tmp_path / f"{name}.img").write_bytes(bytes(MIB))
        grub.install(tmp_path / f"{name}.img", tmp_path / name, first_partition=MIB // grub.SECTOR)
    one = (tmp_path / "one.img").read_bytes()
    assert one == (tmp_path / "two.img").read_bytes()
    assert b"GRUB " in one[:512]
    assert one[512:1024].strip(b"\0")
    program = (tmp_path / "one" / grub.EFI).read_bytes()
    assert program == (tmp_path / "two" / grub.EFI).read_bytes()
    assert program[:2] == b"MZ"
