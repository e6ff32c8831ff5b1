"""Compiled Python: compiles at build time what Debian's scripts would compile on the board."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from evbotos.interpreter import command_of
from evbotos.shell import run

OPENCV: Final = "cv2"
"""A package that reads its own source files; they stay uncompiled."""


def compile_tree(
    interpreter: Path, root: Path, folders: list[str], *, sourceless: bool, skip: str | None = None
) -> None:
    """Compile the Python files in folders of a tree, with the image's paths.

    Args:
        interpreter: the tree of a Python.
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
    run([*command_of(interpreter), "-BP", "-m", "compileall", *how, *places], env=settings)
    if sourceless:
        for place in places:
            for source in place.rglob("*.py"):
                if source.with_suffix(".pyc").is_file():
                    source.unlink()
