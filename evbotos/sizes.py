"""The size of an image by component."""

from __future__ import annotations

import zlib
from collections import defaultdict
from pathlib import Path
from typing import Final

from evbotos.tree import SITE

_LEVEL: Final = 6


def group_of(name: str) -> str:
    """Return the component of a file: a Python package, Python itself, a library, or its folder."""
    parts = name.split("/")
    if name.startswith(f"{SITE}/"):
        package = parts[4].removesuffix(".pyc").removesuffix(".py")
        return f"python: {package.partition('-')[0].partition('.')[0]}"
    if name.startswith("usr/lib/python3."):
        return "python: standard library"
    if ".so" in parts[-1]:
        return f"library: {parts[-1].partition('.so')[0]}"
    if parts[:2] in (["usr", "bin"], ["usr", "sbin"]):
        return f"program: {parts[-1]}"
    return "/".join(parts[:2])


def sizes_of(root: Path) -> dict[str, tuple[int, int]]:
    """Return the bytes and the approximate compressed bytes by component, largest first."""
    found: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    for path in root.rglob("*"):
        if path.is_file() and not path.is_symlink():
            content = path.read_bytes()
            entry = found[group_of(path.relative_to(root).as_posix())]
            entry[0] += len(content)
            entry[1] += len(zlib.compress(content, _LEVEL))
    largest = sorted(found.items(), key=lambda item: (-item[1][1], item[0]))
    return {group: (plain, packed) for group, (plain, packed) in largest}
