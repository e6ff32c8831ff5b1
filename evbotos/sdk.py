"""The SDK of a platform: a sysroot for compiling plugins, and a script that configures compilers.

The sysroot consists of the development image's packages, from the same lock file: binaries compiled with the SDK match
those compiled on that image (Source: thesis §3.5, §5.1).
"""

from __future__ import annotations

import io
import lzma
import os
import tarfile
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from evbotos.errors import BuildError
from evbotos.hosttools import find_tool
from evbotos.lock import Lock
from evbotos.model import Platform
from evbotos.pruning import prune_tree
from evbotos.targets import TARGETS
from evbotos.tree import settle, unpack_packages

IMAGE: Final = "dev"
ENVIRONMENT: Final = "environment"
_KEPT: Final = (
    "lib{,32,64,x32}",  # links into usr, used by linker scripts
    "usr/include/**",
    "usr/lib/**/*.{so,a,o,pc,h}",
    "usr/lib/**/*.so.*",
    "usr/lib/python3*/_sysconfigdata*.py",
    "usr/lib{32,64,x32}/**",
)
_TOOLS_OF_BUILDER: Final = ("usr/lib/gcc/**", "usr/lib/git-core/**", "usr/lib/*/perl*/**", "usr/lib/bfd-plugins/**")
"""Programs' private libraries; the build machine's compiler has its own."""


def make_sysroot(debs: Iterable[Path], root: Path) -> None:
    """Unpack packages into a folder and keep the files that compilers and linkers read.

    Raises:
        BuildError: a package cannot be unpacked, or a required file is missing.
    """
    unpack_packages(debs, root)
    settle(root)
    prune_tree(root, ("**",), _KEPT)
    prune_tree(root, _TOOLS_OF_BUILDER, ())
    make_links_relative(root)
    for needed in ("usr/include/stdio.h", "usr/include/python3*/Python.h", "usr/lib/*/libc.so", "usr/lib/*/crt1.o"):
        if not any(root.glob(needed)):
            raise BuildError(f"the packages of the {IMAGE} image lack {needed}")


def make_links_relative(root: Path) -> None:
    """Convert absolute links into relative links within a tree, and remove broken ones."""
    for link in [path for path in root.rglob("*") if path.is_symlink()]:
        target = link.readlink()
        if target.is_absolute():
            link.unlink()
            link.symlink_to(os.path.relpath(root / target.relative_to("/"), link.parent))
        if not link.exists():
            link.unlink()


def python_of(root: Path) -> str:
    """Return the version of Python in a sysroot, such as `3.11`.

    Raises:
        BuildError: there is none.
    """
    found = sorted(path.parent.name for path in root.glob("usr/include/python3*/Python.h"))
    if not found:
        raise BuildError("the sysroot contains no Python headers")
    return found[-1].removeprefix("python")


def environment_text(platform: Platform, python: str) -> str:
    """Return the script that sets CC and related variables for a platform: `. environment`.

    Args:
        platform: the target platform.
        python: the sysroot's Python version.
    """
    target = TARGETS[platform.architecture]
    abi = f"cpython-{python.replace('.', '')}-{target.multiarch}"
    flags = f"--sysroot=$EVBOTOS_SYSROOT{f' {target.flags}' if target.flags else ''}"
    return f"""\
# Compile for {platform.name}: `. ./{ENVIRONMENT}` in a shell, from any folder, after unpacking.
# Then: $CC $CFLAGS -shared -fPIC $PYTHON_CFLAGS module.c -o module$PYTHON_EXT_SUFFIX $LDFLAGS
_sdk="${{BASH_SOURCE:-$0}}"
[ -n "${{EVBOTOS_SDK:-}}" ] || EVBOTOS_SDK="$(cd "$(dirname "$_sdk")" && pwd)"
if [ ! -f "$EVBOTOS_SDK/sysroot/usr/include/stdio.h" ]; then
    echo "{ENVIRONMENT}: this shell does not report the script's path; set EVBOTOS_SDK to the SDK's folder first" >&2
    return 1 2>/dev/null || exit 1
fi
if ! command -v {target.compiler}gcc >/dev/null; then
    echo "{ENVIRONMENT}: {target.compiler}gcc is not installed: apt-get install {target.package}" >&2
    return 1 2>/dev/null || exit 1
fi
export EVBOTOS_SDK
export EVBOTOS_SYSROOT="$EVBOTOS_SDK/sysroot"
export CC="{target.compiler}gcc {flags}"
export CXX="{target.compiler}g++ {flags}"
export LD="{target.compiler}ld --sysroot=$EVBOTOS_SYSROOT"
export AR="{target.compiler}ar"
export STRIP="{target.compiler}strip"
export CFLAGS="-O2 -g0"
export CXXFLAGS="$CFLAGS"
export LDFLAGS="-Wl,-O1"
export LDSHARED="$CC -shared"
export PKG_CONFIG_SYSROOT_DIR="$EVBOTOS_SYSROOT"
export PKG_CONFIG_LIBDIR="$EVBOTOS_SYSROOT/usr/lib/{target.multiarch}/pkgconfig:$EVBOTOS_SYSROOT/usr/share/pkgconfig"
export PYTHON_CFLAGS="-I$EVBOTOS_SYSROOT/usr/include/python{python}"
export PYTHON_EXT_SUFFIX=".{abi}.so"
export _PYTHON_HOST_PLATFORM="linux-{target.multiarch.partition("-")[0]}"
unset _sdk
"""


def readme_text(platform: Platform, lock: Lock) -> str:
    """Return the README of the SDK."""
    return (
        f"SDK of EvBotOS for {platform.name} ({platform.architecture}): {platform.floor}\n\n"
        f"Needs the compiler of Debian's package {TARGETS[platform.architecture].package}. In a shell:\n\n"
        f"    . ./{ENVIRONMENT}\n"
        "    $CC $CFLAGS -shared -fPIC $PYTHON_CFLAGS module.c -o module$PYTHON_EXT_SUFFIX $LDFLAGS\n\n"
        f"The sysroot contains the packages of the lock file {lock.platform}-{lock.image}:\n\n"
        + "".join(f"    {package.name} {package.version}\n" for package in lock.packages)
    )


def write_archive(folder: Path, name: str, out: Path, epoch: int) -> None:
    """Write a folder as a reproducible .tar.xz.

    Args:
        folder: the input folder.
        name: its name in the archive.
        out: the archive.
        epoch: the date of every file.
    """
    part = out.with_name(f".{out.name}.part")
    with (
        lzma.open(part, "wb", preset=6) as packed,
        tarfile.open(fileobj=packed, mode="w|", format=tarfile.GNU_FORMAT) as tar,
    ):
        for path in sorted(folder.rglob("*")):
            info = tar.gettarinfo(path, f"{name}/{path.relative_to(folder)}")
            info.uid = info.gid = 0
            info.uname = info.gname = "root"
            info.mtime = epoch
            info.mode = 0o755 if info.isdir() or info.mode & 0o100 else 0o644
            if info.islnk():  # a hard link becomes a copy, so the order of files does not matter
                info.type, info.linkname, info.size = tarfile.REGTYPE, "", path.stat().st_size
            if info.isreg():
                tar.addfile(info, io.BytesIO(path.read_bytes()))
            else:
                tar.addfile(info)
    part.replace(out)


def missing_compiler(platform: Platform) -> str | None:
    """Return the package of the compiler that the SDK needs and this machine lacks, or None."""
    target = TARGETS[platform.architecture]
    return None if find_tool(f"{target.compiler}gcc") else target.package
