"""Compiled Python: compiles at build time what Debian's scripts would compile on the board.

The compiler is a Python of the image's version. Build machines have Debian 12, whose Python compiles for its images.
For a newer suite, the suite's own Python runs from a folder, by the dynamic loader of the suite's C library.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from evbotos.errors import BuildError
from evbotos.hosttools import tool
from evbotos.lock import LockedPackage
from evbotos.shell import run

MAGIC: Final = b"\xa7\r\r\n"
"""The magic number of files compiled by Python 3.11, for any architecture."""
OPENCV: Final = "cv2"
"""A package that reads its own source files; they stay uncompiled."""
_ASK: Final = "import importlib.util, sys; sys.stdout.buffer.write(importlib.util.MAGIC_NUMBER)"
_CANDIDATES: Final = (sys.executable, "python3.11", "/usr/bin/python3.11", "/usr/bin/python3")
BUILD_SUITE: Final = "bookworm"
"""The suite of build machines, whose Python they have."""
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


def _command(interpreter: Path | None) -> list[str | Path]:
    if interpreter is None:
        return [find_python()]
    (loader,) = interpreter.glob("usr/lib/*/ld-linux-*.so.*")
    (program,) = interpreter.glob("usr/bin/python3.*")
    return [loader, "--library-path", loader.parent, program]


def find_python() -> str:
    """Return a Python of the build machine that compiles for the Python of Debian 12.

    Raises:
        BuildError: there is none.
    """
    for candidate in _CANDIDATES:
        program = shutil.which(candidate)
        if program is not None:
            done = subprocess.run([program, "-I", "-c", _ASK], capture_output=True, check=False)  # noqa: S603
            if done.stdout == MAGIC:
                return program
    raise BuildError("the image has Python 3.11, which must also compile for it; install python3.11")


def compile_tree(
    interpreter: Path | None, root: Path, folders: list[str], *, sourceless: bool, skip: str | None = None
) -> None:
    """Compile the Python files in folders of a tree, with the image's paths.

    Args:
        interpreter: a tree of `interpreter_packages`; None for the build machine's own Python.
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
