"""Hashes of the inputs of a step: equal inputs give equal keys."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file, in hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def files_sha256(files: Iterable[tuple[str, Path]]) -> str:
    """Return one hash of files, their names and executable bits; links count by their target."""
    digest = hashlib.sha256()
    for name, path in sorted(files):
        what = f"-> {path.readlink()}" if path.is_symlink() else _content(path)
        digest.update(f"{name}\0{what}\n".encode())
    return digest.hexdigest()


def tree_sha256(path: Path) -> str:
    """Return one hash of a file, or of the files of a folder."""
    paths = [path] if path.is_file() else [item for item in path.rglob("*") if item.is_symlink() or item.is_file()]
    return files_sha256((item.relative_to(path).as_posix(), item) for item in paths)


def _content(path: Path) -> str:
    return f"{file_sha256(path)} {bool(path.stat().st_mode & 0o100)}"


def key_of(inputs: object, *modules: ModuleType) -> str:
    """Return the key of a step: a hash of its inputs and its code.

    Args:
        inputs: JSON-compatible data.
        modules: the modules whose change invalidates the step.
    """
    code = [file_sha256(Path(str(module.__file__))) for module in modules]
    return hashlib.sha256(json.dumps([inputs, code], sort_keys=True).encode()).hexdigest()[:24]
