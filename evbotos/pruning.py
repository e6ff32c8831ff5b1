"""Pruning: removes files from an image by path patterns."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

_PART = re.compile(r"\*\*/|\*\*|\*|\?|\{[^{}]*\}|\[[^]]*\]|.")


def pattern_to_regex(pattern: str) -> re.Pattern[str]:
    """Return the regular expression of a pattern: `*` within a folder, `**` across folders, `{a,b}`, `[ab]`, `?`."""
    parts = []
    for part in _PART.findall(pattern):
        if part == "**/":
            parts.append("(?:.*/)?")
        elif part == "**":
            parts.append(".*")
        elif part == "*":
            parts.append("[^/]*")
        elif part == "?":
            parts.append("[^/]")
        elif part.startswith("{"):
            choices = part[1:-1].split(",")
            parts.append(f"(?:{'|'.join(pattern_to_regex(choice).pattern for choice in choices)})")
        elif part.startswith("[") and len(part) > 1:
            parts.append(part)
        else:
            parts.append(re.escape(part))
    return re.compile("".join(parts))


def left_out(paths: Iterable[str], prune: Sequence[str], keep: Sequence[str]) -> list[str]:
    """Return the paths that match a pattern of `prune` and none of `keep`."""
    unwanted = [pattern_to_regex(pattern) for pattern in prune]
    wanted = [pattern_to_regex(pattern) for pattern in keep]
    return [
        path
        for path in paths
        if any(pattern.fullmatch(path) for pattern in unwanted) and not any(p.fullmatch(path) for p in wanted)
    ]


def prune_tree(root: Path, prune: Sequence[str], keep: Sequence[str]) -> int:
    """Remove files and the resulting empty folders from a tree; return the number of removed bytes."""
    files = [path for path in root.rglob("*") if path.is_symlink() or not path.is_dir()]
    by_name = {path.relative_to(root).as_posix(): path for path in files}
    removed = 0
    emptied: set[Path] = set()
    for name in left_out(by_name, prune, keep):
        path = by_name[name]
        removed += 0 if path.is_symlink() else path.stat().st_size
        path.unlink()
        emptied.update(itertools.takewhile(lambda folder: folder != root, path.parents))
    for folder in sorted(emptied, key=lambda folder: len(folder.parts), reverse=True):
        if not any(folder.iterdir()):
            folder.rmdir()
    return removed
