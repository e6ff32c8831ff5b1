"""What boards without GRUB start by: their ROM's first files, out of Debian's packages, and what those read."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from evbotos.disk import DISK_ID, kernel_line
from evbotos.errors import BuildError
from evbotos.hosttools import tool
from evbotos.model import Platform
from evbotos.shell import run

KERNEL: Final = "vmlinuz"


def write_board_boot(platform: Platform, packages: Mapping[str, Path], kernel_folder: Path, out: Path) -> None:
    """Fill a folder with what the boot partition of a board holds.

    Args:
        platform: with `u-boot` or `raspberry-pi` as its loader.
        packages: by name, the files of the packages that `boot_files` names.
        kernel_folder: with the kernel and its device trees.
        out: the folder, which is made.

    Raises:
        BuildError: a package lacks a file.
    """
    out.mkdir(parents=True)
    for name, files in platform.boot_files.items():
        with TemporaryDirectory(dir=out.parent, prefix=".part-boot-") as folder:
            run([tool("dpkg-deb"), "-x", packages[name], folder])
            for source, target in files.items():
                if not (Path(folder) / source).is_file():
                    raise BuildError(f"{name} has no file {source}")
                shutil.copy(Path(folder) / source, out / target)
    shutil.copy(kernel_folder / platform.kernel.file, out / KERNEL)
    for tree in platform.kernel.device_trees:
        shutil.copy(kernel_folder / Path(tree).name, out / Path(tree).name)
    words = f"root=PARTUUID={DISK_ID}-02 {kernel_line(platform)}"
    if platform.loader == "u-boot":
        (out / "extlinux").mkdir()
        (out / "extlinux/extlinux.conf").write_text(extlinux(words))
    else:
        (out / "config.txt").write_text(_CONFIG)
        (out / "cmdline.txt").write_text(f"{words}\n")


def extlinux(words: str) -> str:
    """Return the menu that U-Boot reads; it chooses the board's device tree itself.

    Args:
        words: what the kernel is told.
    """
    return f"default evbotos\ntimeout 1\nlabel evbotos\n  kernel /{KERNEL}\n  fdtdir /\n  append {words}\n"


_CONFIG: Final = f"""# Read by the Raspberry Pi's firmware.
arm_64bit=1
enable_uart=1
gpu_mem=16
kernel={KERNEL}
upstream_kernel=1
start_file=start_cd.elf
fixup_file=fixup_cd.dat
[pi4]
start_file=start4cd.elf
fixup_file=fixup4cd.dat
"""
