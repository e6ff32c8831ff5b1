"""The boot files of boards with U-Boot in the disk image."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from evbotos.definitions import load_definitions
from evbotos.disk import DISK_ID, Contents, parts_of, write_disk
from evbotos.errors import BuildError
from evbotos.hosttools import find_tool
from evbotos.lock import lock_path, read_lock
from evbotos.model import EmulatorLoader, Layout, Platform
from evbotos.qemu import loader_of, write_device_tree
from evbotos.sbom import bill_of_materials
from evbotos.u_boot import SCRIPT, write_board_files
from evbotos.verity import Verity

TOOLS = ("sfdisk", "mformat", "mcopy", "mdir", "mtype", "mke2fs", "dpkg-deb", "mkimage")
VERITY = Verity(1, "ab" * 32, "cd" * 16)
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
    write_board_files(platform, packages, kernel, folder / "board")
    kernel_file = kernel / platform.kernel.file
    contents = Contents(platform, folder / "root", VERITY, kernel_file, folder / "board", None, None, 1_700_000_000)
    write_disk(folder / "disk.img", LAYOUT, contents)
    return folder / "disk.img"


def mtools(program: str, disk: Path, *words: str, errors: str = "strict") -> str:
    place = f"{disk}@@{parts_of(LAYOUT).boot[0]}"
    return subprocess.run([program, "-i", place, *words], capture_output=True, check=True).stdout.decode(errors=errors)


def test_the_beagleboards_rom_finds_its_loader_first(tmp_path: Path) -> None:
    disk = disk_of(load_definitions().platform("beagle-armhf"), tmp_path)
    table = subprocess.run([str(find_tool("sfdisk")), "-d", disk], capture_output=True, text=True, check=True).stdout
    first = next(line for line in table.splitlines() if line.startswith(f"{disk}1"))
    assert "type=c, bootable" in first  # the ROM looks for a FAT there
    names = mtools("mdir", disk, "-b", "::/").split()
    assert names[0] == "::/MLO"
    assert {"::/u-boot.img", "::/vmlinuz-a", "::/vmlinuz-b", "::/omap3-beagle.dtb"} <= set(names)
    assert mtools("mtype", disk, "::/MLO") == "usr/lib/u-boot/omap3_beagle/MLO"


@pytest.mark.parametrize(
    ("name", "starts"),
    [
        ("beagle-armhf", "bootz ${kernel_addr_r} - ${tree}"),
        ("qemu-arm64", "booti ${kernel_addr_r} - ${tree}"),
        ("raspberry-pi", "booti ${kernel_addr_r} - ${tree}"),
    ],
)
def test_the_script_starts_the_slot_that_is_chosen(tmp_path: Path, name: str, starts: str) -> None:
    script = mtools("mtype", disk_of(load_definitions().platform(name), tmp_path), f"::/{SCRIPT}", errors="replace")
    slot = f"PARTUUID={DISK_ID}-${{number}}"
    table = f'dm-mod.create=\\"root,,,ro,0 ${{sectors}} verity 1 {slot} {slot} ${{verity}}\\" ro '
    assert f'setenv bootargs "root=/dev/dm-0 rootfstype=squashfs dm-mod.waitfor={slot} {table}' in script
    assert 'evbotos.slot=${slot}"' in script
    assert starts in script
    assert "console=" not in script  # the device tree says it


def test_the_raspberry_pis_firmware_finds_all_that_its_settings_name(tmp_path: Path) -> None:
    disk = disk_of(load_definitions().platform("raspberry-pi"), tmp_path)
    names = {name.removeprefix("::/") for name in mtools("mdir", disk, "-b", "::/").split()}
    assert {"bootcode.bin", "bcm2837-rpi-3-b.dtb", "bcm2711-rpi-4-b.dtb"} <= names
    settings = mtools("mtype", disk, "::/config.txt").splitlines()
    keys = ("kernel=", "start_file=", "fixup_file=", "device_tree=")
    named = {line.partition("=")[2] for line in settings if line.startswith(keys)}
    assert len(named) == 6
    assert named <= names


def test_the_firmware_of_a_raspberry_pi_5_finds_the_overlay_of_newer_steppings(tmp_path: Path) -> None:
    disk = disk_of(load_definitions().platform("raspberry-pi-5"), tmp_path)
    assert "overlay_prefix=overlays/" in mtools("mtype", disk, "::/config.txt").splitlines()
    assert "brcm,bcm2712d0-pinctrl" in mtools("mtype", disk, "::/overlays/bcm2712d0.dtbo", errors="replace")


@pytest.mark.parametrize("name", ["beagle-armhf", "raspberry-pi", "raspberry-pi-5"])
def test_two_disks_of_the_same_contents_are_the_same_bytes(tmp_path: Path, name: str) -> None:
    platform = load_definitions().platform(name)
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
    one, two = (disk_of(platform, tmp_path / folder) for folder in ("one", "two"))
    assert one.read_bytes() == two.read_bytes()


def test_a_package_without_its_file_is_told(tmp_path: Path) -> None:
    platform = load_definitions().platform("beagle-armhf")
    empty = package(tmp_path, "u-boot-omap", [])
    with pytest.raises(BuildError, match="u-boot-omap has no file usr/lib/u-boot/omap3_beagle/MLO"):
        write_board_files(platform, {"u-boot-omap": empty}, tmp_path, tmp_path / "board")


@pytest.mark.parametrize(("name", "loader"), [("beagle-armhf", "u-boot-omap"), ("qemu-amd64", "grub-pc-bin")])
def test_the_bill_of_materials_names_what_starts_the_board_but_nothing_of_its_emulator(name: str, loader: str) -> None:
    found = load_definitions()
    platform, image = found.platform(name), found.image("robot")
    lock = read_lock(lock_path(platform, image))
    assert lock is not None
    bill = json.loads(bill_of_materials(lock, image, platform, {}))
    names = {component["name"] for component in bill["components"]}
    assert loader in names
    assert not {"u-boot-sunxi", "dpkg-dev"} & names


@pytest.mark.parametrize("name", sorted(load_definitions().platforms))
def test_the_lock_pins_what_starts_a_board(name: str) -> None:
    found = load_definitions()
    platform = found.platform(name)
    lock = read_lock(lock_path(platform, found.image("robot")))
    assert lock is not None
    assert platform.boot_packages
    assert set(platform.boot_packages) <= {package.name for package in lock.build_packages}


def test_what_the_emulator_does_not_bear_is_blanked_in_its_loader() -> None:
    loader = EmulatorLoader(
        package="u-boot-rpi", file="u-boot.bin", skip=2, blank=("usb start;",), arguments=("-kernel",)
    )
    assert loader_of(b"..preboot=usb start;\0", loader) == b"preboot=          \0"
    with pytest.raises(BuildError, match=r"u-boot\.bin does not say 'usb start;'"):
        loader_of(b"..preboot=\0", loader)


def test_a_node_that_the_emulator_lacks_is_disabled_in_its_device_tree(tmp_path: Path) -> None:
    if find_tool("fdtput") is None or find_tool("dtc") is None:
        pytest.skip("not installed: fdtput (make evbotos-setup)")
    source, tree, out = tmp_path / "tree.dts", tmp_path / "tree.dtb", tmp_path / "emulator.dtb"
    source.write_text('/dts-v1/; / { soc { watchdog@7e100000 { status = "okay"; }; }; };')
    subprocess.run(["dtc", "-q", "-O", "dtb", "-o", tree, source], check=True)
    write_device_tree(tree, ["/soc/watchdog@7e100000"], out)
    status = ["fdtget", str(out), "/soc/watchdog@7e100000", "status"]
    assert subprocess.run(status, capture_output=True, text=True, check=True).stdout == "disabled\n"
    with pytest.raises(BuildError, match=r"QEMU's machine needs other\.dtb: name it under the kernel's `device_trees`"):
        write_device_tree(tmp_path / "other.dtb", [], out)
    with pytest.raises(BuildError, match="FDT_ERR_NOTFOUND"):
        write_device_tree(tree, ["/soc/wifi"], out)
