"""Compiled Python: what Debian's own scripts would compile on the board is compiled here, once."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final

from evbotos.errors import BuildError
from evbotos.shell import run

MAGIC: Final = b"\xa7\r\r\n"
"""Of the compiled files of Python 3.11, any architecture."""
OPENCV: Final = "cv2"
"""A package that reads files of its own as source, so that these stay."""
_ASK: Final = "import importlib.util, sys; sys.stdout.buffer.write(importlib.util.MAGIC_NUMBER)"
_CANDIDATES: Final = (sys.executable, "python3.11", "/usr/bin/python3.11", "/usr/bin/python3")


def find_python() -> str:
    """Return a Python of the build machine whose compiled files the image's Python can read.

    Raises:
        BuildError: there is none.
    """
    for candidate in _CANDIDATES:
        program = shutil.which(candidate)
        if program is not None:
            done = subprocess.run([program, "-I", "-c", _ASK], capture_output=True, check=False)  # noqa: S603
            if done.stdout == MAGIC:
                return program
    raise BuildError("the image's Python is 3.11, and so must be that which compiles for it: install python3.11")


def compile_tree(root: Path, folders: list[str], *, sourceless: bool, skip: str | None = None) -> None:
    """Compile the Python files of some folders of a tree, with paths as they are in the image.

    Args:
        root: of the tree.
        folders: below it.
        sourceless: put the compiled file in the place of its source.
        skip: pattern of paths that are not compiled, if any.

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
    # One process with a fixed order of sets: else two builds differ.
    run([find_python(), "-m", "compileall", *how, *places], env={"PYTHONHASHSEED": "0", "PYTHONNOUSERSITE": "1"})
    if sourceless:
        for place in places:
            for source in place.rglob("*.py"):
                if source.with_suffix(".pyc").is_file():
                    source.unlink()
