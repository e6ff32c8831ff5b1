"""U-Boot, the loader of boards without a BIOS: its script, and the files that their ROMs load first."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from evbotos import slots
from evbotos.errors import BuildError
from evbotos.hosttools import tool
from evbotos.model import Kernel, Platform
from evbotos.overlays import compile_overlay
from evbotos.shell import run
from evbotos.verity import kernel_words

SCRIPT: Final = "boot.scr"
"""U-Boot searches every bootable partition for this file."""
OVERLAYS: Final = "overlays"
"""The folder of the boot partition in which a Raspberry Pi's firmware looks for overlays."""
_START: Final = {
    "arm": ("${kernel_addr_r}", "bootz ${kernel_addr_r} - ${tree}"),
    # A 64-bit kernel does not unpack itself.
    "arm64": ("${ramdisk_addr_r}", "unzip ${ramdisk_addr_r} ${kernel_addr_r} && booti ${kernel_addr_r} - ${tree}"),
}
"""Load address and start command by kernel architecture."""


def script(platform: Platform, kernel_line: str, disk_id: str) -> str:
    """Return U-Boot's script, the equivalent of GRUB's menu on PCs.

    Args:
        platform: a platform with a compiled ARM kernel.
        kernel_line: the kernel's command line without root and slot.
        disk_id: the disk's signature, eight hex digits.
    """
    # OMAP's `fdt_addr_r` and `ramdisk_addr_r` are beyond 128 MB. The tree stays at its load address, which must not be
    # in the range into which the kernel unpacks itself.
    assert isinstance(platform.kernel, Kernel)  # noqa: S101  # U-Boot starts no other kind
    address, start = _START[platform.kernel.architecture]
    root = kernel_words(disk_id, "${number}", "${sectors}", "${verity}", '\\"')
    return f"""setenv part "${{devtype}} ${{devnum}}:${{distro_bootpart}}"
setenv good
setenv try
setenv starts
setenv floor
if load ${{part}} ${{pxefile_addr_r}} {slots.FILE}; then
  env import -t ${{pxefile_addr_r}} ${{filesize}} good try starts floor
fi
if test -z "${{good}}"; then setenv good a; fi
setenv slot ${{good}}
if test -n "${{try}}"; then
  setenv slot ${{try}}
  setenv try
elif test "${{starts}}" = xxx; then
  echo "evbotos: slot ${{slot}} did not come up three times"
  setenv starts x
  if test "${{slot}}" = a; then setenv slot b; else setenv slot a; fi
else
  setenv starts ${{starts}}x
fi
env export -t -s {slots.SIZE:#x} ${{pxefile_addr_r}} good try starts floor
fatwrite ${{part}} ${{pxefile_addr_r}} {slots.FILE} {slots.SIZE:#x}
setenv tree ${{fdt_addr}}
if test -n "${{fdtfile}}"; then
  if test -e ${{part}} ${{fdtfile}}; then
    setexpr tree ${{kernel_addr_r}} + 0x1000000
    load ${{part}} ${{tree}} ${{fdtfile}}
  fi
fi
for turn in 1 2; do
  if test "${{slot}}" = b; then setenv number 03; else setenv number 02; fi
  setenv verity
  if load ${{part}} ${{pxefile_addr_r}} root-${{slot}}.env; then
    env import -t ${{pxefile_addr_r}} ${{filesize}} sectors verity
  fi
  if test -n "${{verity}}"; then
    echo "evbotos: slot ${{slot}}"
    setenv bootargs "{root} {kernel_line} evbotos.slot=${{slot}}"
    if load ${{part}} {address} vmlinuz-${{slot}}; then {start}; fi
  else
    echo "evbotos: no verified system in the other slot, ${{slot}}"
  fi
  if test "${{slot}}" = a; then setenv slot b; else setenv slot a; fi
done
reset
"""


def compile_script(text: str, epoch: int) -> bytes:
    """Compile a script for U-Boot.

    Raises:
        BuildError: mkimage failed.
    """
    with TemporaryDirectory() as folder:
        source, out = Path(folder) / "boot.cmd", Path(folder) / SCRIPT
        source.write_text(text)
        options: list[str | Path] = ["-A", "arm", "-T", "script", "-C", "none", "-n", "evbotos", "-d", source, out]
        run([tool("mkimage"), *options], env={"SOURCE_DATE_EPOCH": str(epoch)})
        return out.read_bytes()


def write_board_files(platform: Platform, packages: Mapping[str, Path], kernel_folder: Path, out: Path) -> None:
    """Fill a folder with a board's boot files except kernels: U-Boot, its loaders, device trees and their overlays.

    Args:
        platform: the platform.
        packages: the package files of `boot_files` by name.
        kernel_folder: a folder with the kernel's device trees.
        out: the output folder, created here.

    Raises:
        BuildError: a package lacks a file, or an overlay is malformed.
    """
    out.mkdir(parents=True)
    for name, files in platform.boot_files.items():
        for target, content in zip(files.values(), read_files(packages[name], name, files), strict=True):
            (out / target).write_bytes(content)
    for target, text in platform.boot_texts.items():
        (out / target).write_text(text)
    for tree in platform.kernel.device_trees:
        shutil.copy(kernel_folder / Path(tree).name, out / Path(tree).name)
    for name in platform.firmware_overlays:
        (out / OVERLAYS).mkdir(exist_ok=True)
        compile_overlay(name, out / OVERLAYS / f"{Path(name).stem}.dtbo")


def read_files(package: Path, name: str, sources: Iterable[str]) -> list[bytes]:
    """Return files of a Debian package.

    Args:
        package: the package's file.
        name: the package's name, for the message.
        sources: paths in the package.

    Raises:
        BuildError: a file is missing.
    """
    with TemporaryDirectory() as folder:
        run([tool("dpkg-deb"), "-x", package, folder])
        files = [Path(folder) / source for source in sources]
        for source, file in zip(sources, files, strict=True):
            if not file.is_file():
                raise BuildError(f"{name} has no file {source}")
        return [file.read_bytes() for file in files]
