"""Compiled Python: compiles at build time what Debian's scripts would compile on the board.

The compiler is the suite's own Python, for the build machine, in a folder. The dynamic loader of the suite's C library
runs it, so that the build machine may have any other Python, and every one makes the same files.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final

from evbotos.errors import BuildError
from evbotos.hosttools import tool
from evbotos.lock import LockedPackage
from evbotos.shell import run

OPENCV: Final = "cv2"
"""A package that reads its own source files; they stay uncompiled."""
BUILD_MACHINES: Final = ("amd64", "arm64")
"""Architectures of build machines, by Debian's names."""


def interpreter_packages(python: str) -> tuple[str, ...]:
    """Return the Debian packages of a Python of a version, such as `3.13`, that compiles files."""
    return ("libc6", "libexpat1", f"libpython{python}-minimal", f"python{python}-minimal", "zlib1g")


def of_this_machine(packages: Iterable[LockedPackage]) -> list[LockedPackage]:
    """Return the packages for the build machine's architecture.

    Raises:
        BuildError: there are none.
    """
    architecture = run([tool("dpkg"), "--print-architecture"]).strip()
    found = [package for package in packages if package.path.endswith(f"_{architecture}.deb")]
    if not found:
        raise BuildError(f"there is no Python for a build machine of {architecture}, only for {BUILD_MACHINES}")
    return found


def _command(interpreter: Path) -> list[str | Path]:
    (loader,) = interpreter.glob("usr/lib/*/ld-linux-*.so.*")
    (program,) = interpreter.glob("usr/bin/python3.*")
    return [loader, "--library-path", loader.parent, program]


def compile_tree(
    interpreter: Path, root: Path, folders: list[str], *, sourceless: bool, skip: str | None = None
) -> None:
    """Compile the Python files in folders of a tree, with the image's paths.

    Args:
        interpreter: a tree of `interpreter_packages`.
        root: the root of the tree.
        folders: relative to the root.
        sourceless: replace each source file by its compiled file.
        skip: a pattern of paths that stay uncompiled.

    Raises:
        BuildError: a file cannot be compiled.
    """
    places = [root / folder for folder in folders if (root / folder).is_dir()]
    if not places:
        return
    mode = [*(["-b"] if sourceless else []), *(["-x", skip] if skip is not None else [])]
    how: list[str | Path] = [
        "-q",
        "-f",
        "-j",
        "1",
        "--invalidation-mode",
        "unchecked-hash",
        "-s",
        root,
        "-p",
        "/",
        *mode,
    ]
    # One process with a fixed hash seed; otherwise builds are not reproducible.
    settings = {"PYTHONHASHSEED": "0", "PYTHONNOUSERSITE": "1"}
    run([*_command(interpreter), "-BP", "-m", "compileall", *how, *places], env=settings)
    if sourceless:
        for place in places:
            for source in place.rglob("*.py"):
                if source.with_suffix(".pyc").is_file():
                    source.unlink()
