"""The root file system as one compressed, read-only file."""

from __future__ import annotations

from pathlib import Path
from typing import Final, Literal

from evbotos.hosttools import tool
from evbotos.shell import run

_OPTIONS: Final = {
    "zstd": ("-comp", "zstd", "-Xcompression-level", "19", "-b", "128K"),
    "xz": ("-comp", "xz", "-b", "128K"),
}


def squash(root: Path, out: Path, compression: Literal["zstd", "xz"], epoch: int) -> None:
    """Compress a tree reproducibly: every file belongs to root and has the same date.

    Raises:
        BuildError: mksquashfs failed.
    """
    same = ("-all-root", "-all-time", str(epoch), "-mkfs-time", str(epoch), "-no-xattrs", "-no-exports", "-noappend")
    run([tool("mksquashfs"), root, out, *_OPTIONS[compression], *same, "-no-progress", "-quiet"])
