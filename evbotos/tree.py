"""The tree of a root file system: packages and wheels, unpacked and set up without their scripts."""

from __future__ import annotations

import os
import re
import shutil
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from evbotos.errors import BuildError
from evbotos.hosttools import tool
from evbotos.shell import run, run_binary

SITE: Final = "usr/lib/python3/dist-packages"
_MERGED: Final = ("bin", "sbin", "lib", "lib32", "lib64", "libx32")
"""Folders that Debian moved to /usr, leaving links."""
_APPLETS: Final = re.compile(rb"\0\[\0\[\[\0(?:[a-z0-9_+.-]+\0){100,}")
_ELF: Final = b"\x7fELF"


def unpack_packages(files: Iterable[Path], root: Path) -> None:
    """Unpack Debian packages without running their scripts.

    Raises:
        BuildError: a package cannot be unpacked.
    """
    for name in _MERGED:
        (root / "usr" / name).mkdir(parents=True, exist_ok=True)
        (root / name).symlink_to(f"usr/{name}")
    for file in files:
        content = run_binary([tool("dpkg-deb"), "--fsys-tarfile", file])
        run([tool("tar"), "-x", "--keep-directory-symlink", "--no-same-owner", "-C", root], data=content)
    for name in _MERGED:
        if not any((root / "usr" / name).iterdir()):
            (root / name).unlink()
            (root / "usr" / name).rmdir()


def unpack_wheels(files: Iterable[Path], root: Path) -> None:
    """Unpack wheels next to Debian's Python packages, without their programs."""
    site = root / SITE
    site.mkdir(parents=True, exist_ok=True)
    for file in files:
        with zipfile.ZipFile(file) as archive:
            for info in archive.infolist():
                if ".data/" not in info.filename:
                    archive.extract(info, site)


def settle(root: Path) -> None:
    """Do the work of the packages' scripts: busybox's commands and the linear algebra libraries."""
    _link_busybox(root)
    for library in ("blas/libblas.so.3", "lapack/liblapack.so.3"):
        for file in root.glob(f"usr/lib/*/{library}"):
            link = file.parent.parent / file.name
            if not link.is_symlink():
                link.symlink_to(library)


def _link_busybox(root: Path) -> None:
    """Link each busybox command unless another package provides that program."""
    busybox = root / "usr/bin/busybox"
    if not busybox.exists():
        return
    for name in busybox_applets(busybox.read_bytes()):
        if name != "busybox" and not any(os.path.lexists(root / "usr" / folder / name) for folder in ("bin", "sbin")):
            (root / "usr/bin" / name).symlink_to("busybox")


def busybox_applets(program: bytes) -> list[str]:
    """Return the commands of a busybox binary of any architecture: an alphabetical list of names in it.

    Raises:
        BuildError: the binary contains no such list.
    """
    match = _APPLETS.search(program)
    names = match[0].strip(b"\0").decode().split("\0") if match is not None else []
    in_order: list[str] = []
    for name in names:
        if in_order and name <= in_order[-1]:  # the end of the list
            break
        in_order.append(name)
    if not {"init", "mount", "sh"} <= set(in_order):
        raise BuildError("the busybox binary contains no list of commands")
    return in_order


def overlay(source: Path, root: Path) -> None:
    """Copy a folder onto a tree; keep links and modes."""
    for path in sorted(source.rglob("*")):
        if "__pycache__" in path.parts:
            continue
        there = root / path.relative_to(source)
        if path.is_dir() and not path.is_symlink():
            there.mkdir(parents=True, exist_ok=True)
            continue
        there.parent.mkdir(parents=True, exist_ok=True)
        there.unlink(missing_ok=True)
        shutil.copy2(path, there, follow_symlinks=False)


def normalise(root: Path) -> None:
    """Give every file one of two modes, independent of the builder's umask."""
    for path in root.rglob("*"):
        if not path.is_symlink():
            is_open = path.is_dir() or path.stat().st_mode & 0o100
            path.chmod(0o755 if is_open else 0o644)
    root.chmod(0o755)


def needed_libraries(root: Path) -> dict[str, list[str]]:
    """Return the shared libraries that programs and libraries of a tree need, with those that need them."""
    programs = [path for path in root.rglob("*") if _is_elf(path)]
    needed: dict[str, list[str]] = {}
    if not programs:
        return needed
    owner = ""
    for line in run([tool("readelf"), "-d", "-W", *programs]).splitlines():
        if line.startswith("File: "):
            owner = line.removeprefix("File: ").removeprefix(f"{root}/")
        elif "(NEEDED)" in line:
            needed.setdefault(line.partition("[")[2].rstrip("]"), []).append(owner)
    return needed


def missing_libraries(root: Path) -> dict[str, list[str]]:
    """Return the missing shared libraries of a tree with the programs that need them."""
    there = {path.name for path in root.rglob("*.so*")}
    return {name: users for name, users in needed_libraries(root).items() if name not in there}


def _is_elf(path: Path) -> bool:
    if path.is_symlink() or not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(4) == _ELF
