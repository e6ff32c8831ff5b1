"""The programs that a build needs, and their Debian packages."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from evbotos.errors import MissingToolsError
from evbotos.model import Kernel, Platform
from evbotos.targets import TARGETS

PACKAGES: Final = {
    "apt-get": "apt",
    "dpkg-deb": "dpkg",
    "tar": "tar",
    "readelf": "binutils",
    "mksquashfs": "squashfs-tools",
    "unsquashfs": "squashfs-tools",
    "sfdisk": "fdisk",
    "blkid": "util-linux",
    "setpriv": "util-linux",
    "mformat": "mtools",
    "mcopy": "mtools",
    "mdir": "mtools",
    "mke2fs": "e2fsprogs",
    "veritysetup": "cryptsetup-bin",
    "grub-mkimage": "grub-common",
    "mkimage": "u-boot-tools",
    "dtc": "device-tree-compiler",
    "fdtoverlay": "device-tree-compiler",
    "fdtput": "device-tree-compiler",
    "gcc": "gcc",
    "make": "make",
    "flex": "flex",
    "bison": "bison",
    "bc": "bc",
    "xz": "xz-utils",
    "zstd": "zstd",
    "qemu-system-x86_64": "qemu-system-x86",
    "qemu-system-i386": "qemu-system-x86",
    "qemu-system-arm": "qemu-system-arm",
    "qemu-system-aarch64": "qemu-system-arm",
    "aarch64-linux-gnu-gcc": "gcc-aarch64-linux-gnu",
    "arm-linux-gnueabihf-gcc": "gcc-arm-linux-gnueabihf",
    "/usr/include/gelf.h": "libelf-dev",
    "/usr/include/openssl/opensslv.h": "libssl-dev",
}
"""Packages by program, or by file if a package has no program."""

_ROOT: Final = ("apt-get", "dpkg-deb", "tar", "readelf", "mksquashfs")
_KERNEL: Final = (
    "gcc",
    "make",
    "flex",
    "bison",
    "bc",
    "xz",
    "zstd",
    "/usr/include/gelf.h",
    "/usr/include/openssl/opensslv.h",
)
_DISK: Final = ("sfdisk", "mformat", "mcopy", "mke2fs", "veritysetup")
_GRUB: Final = ("grub-mkimage",)
_U_BOOT: Final = ("mkimage",)
_OVERLAYS: Final = ("dtc", "fdtoverlay")
_ADMIN_FOLDERS: Final = ("/usr/sbin", "/sbin")


def needed_for(platform: Platform) -> list[str]:
    """Return the programs that a build for a platform needs."""
    tools = [*_ROOT, *_DISK]
    if platform.compiled_wheels:
        tools.append(f"{TARGETS[platform.architecture].compiler}gcc")
    tools += {"grub": _GRUB, "u-boot": _U_BOOT, "none": ()}[platform.loader]
    if platform.emulator is not None and platform.emulator.lacks:
        tools.append("fdtput")
    if platform.overlays or platform.firmware_overlays:
        tools += _OVERLAYS
    if isinstance(platform.kernel, Kernel):
        tools += _KERNEL
        if platform.kernel.cross is not None:
            tools.append(f"{platform.kernel.cross}gcc")
    return tools


def find_tool(name: str) -> str | None:
    """Return the path of a program, including administrators' programs, or None."""
    if name.startswith("/"):
        return name if Path(name).exists() else None
    return shutil.which(name, path=os.pathsep.join([os.environ.get("PATH", os.defpath), *_ADMIN_FOLDERS]))


def tool(name: str) -> str:
    """Return the path of a program.

    Raises:
        MissingToolsError: the program is not installed.
    """
    found = find_tool(name)
    if found is None:
        raise MissingToolsError(_message([name]))
    return found


def require(names: Iterable[str]) -> None:
    """Check that programs are installed.

    Raises:
        MissingToolsError: lists all missing programs with the packages to install.
    """
    missing = [name for name in dict.fromkeys(names) if find_tool(name) is None]
    if missing:
        raise MissingToolsError(_message(missing))


def _message(missing: list[str]) -> str:
    packages = sorted({PACKAGES.get(name, name) for name in missing})
    return (
        f"not installed: {', '.join(missing)}; `make evbotos-setup` installs all of them, "
        f"or: apt-get install {' '.join(packages)}"
    )
