"""Compiled Python: compiles at build time what Debian's scripts would compile on the board."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final

from evbotos.errors import BuildError
from evbotos.shell import run

MAGIC: Final = b"\xa7\r\r\n"
"""The magic number of files compiled by Python 3.11, for any architecture."""
OPENCV: Final = "cv2"
"""A package that reads its own source files; they stay uncompiled."""
_ASK: Final = "import importlib.util, sys; sys.stdout.buffer.write(importlib.util.MAGIC_NUMBER)"
_CANDIDATES: Final = (sys.executable, "python3.11", "/usr/bin/python3.11", "/usr/bin/python3")


def find_python() -> str:
    """Return a Python of the build machine that compiles for the image's Python.

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


def compile_tree(root: Path, folders: list[str], *, sourceless: bool, skip: str | None = None) -> None:
    """Compile the Python files in folders of a tree, with the image's paths.

    Args:
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
    run([find_python(), "-P", "-m", "compileall", *how, *places], env={"PYTHONHASHSEED": "0", "PYTHONNOUSERSITE": "1"})
    if sourceless:
        for place in places:
            for source in place.rglob("*.py"):
                if source.with_suffix(".pyc").is_file():
                    source.unlink()
