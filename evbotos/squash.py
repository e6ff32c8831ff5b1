"""The root file system as one compressed, read-only file."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final, Literal

from evbotos.hosttools import tool
from evbotos.shell import run

_OPTIONS: Final = {
    "zstd": ("-comp", "zstd", "-Xcompression-level", "19", "-b", "128K"),
    "xz": ("-comp", "xz", "-b", "512K"),
}
_BRANCH_FILTERS: Final = {"amd64": "x86", "i386": "x86", "armhf": "armthumb"}
"""Processors for whose jumps xz has a filter."""


def options_of(compression: Literal["zstd", "xz"], architecture: str) -> tuple[str, ...]:
    """Return mksquashfs's options for a compression of programs of an architecture, by Debian's name."""
    options = _OPTIONS[compression]
    if compression == "xz" and architecture in _BRANCH_FILTERS:
        return (*options, "-Xbcj", _BRANCH_FILTERS[architecture])
    return options


def squash(root: Path, out: Path, options: Iterable[str], epoch: int) -> None:
    """Compress a tree reproducibly: every file belongs to root and has the same date.

    Raises:
        BuildError: mksquashfs failed.
    """
    same = ("-all-root", "-all-time", str(epoch), "-mkfs-time", str(epoch), "-no-xattrs", "-no-exports", "-noappend")
    run([tool("mksquashfs"), root, out, *options, *same, "-no-progress", "-quiet"])
