"""Device tree overlays: changes to the device trees of a board, such as a bus on its pins, that a user selects.

An overlay is a source file of the device tree compiler. Its targets are labels of the board's device tree, or paths
(`target-path`): the trees of Linux 6.1 have no labels. Files to `/include/` are next to it.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from evbotos.errors import BuildError
from evbotos.fields import overlay_file
from evbotos.hashing import file_sha256
from evbotos.hosttools import tool
from evbotos.shell import run


def compile_overlay(name: str, out: Path) -> None:
    """Compile an overlay.

    Args:
        name: see `overlay_file`.
        out: the new file.

    Raises:
        BuildError: it is malformed.
    """
    run([tool("dtc"), "-q", "-@", "-I", "dts", "-O", "dtb", "-o", out, overlay_file(name)])


def overlay_sha256(name: str) -> str:
    """Return the hash of a compiled overlay, which covers the files that it includes.

    Args:
        name: see `overlay_file`.

    Raises:
        BuildError: it is malformed.
    """
    with TemporaryDirectory() as folder:
        compiled = Path(folder) / "dtbo"
        compile_overlay(name, compiled)
        return file_sha256(compiled)


def write_trees(kernel_folder: Path, trees: Sequence[str], overlays: Sequence[str], out: Path) -> None:
    """Copy the folder of a kernel, and apply overlays to its device trees.

    Args:
        kernel_folder: the folder.
        trees: the file names of its device trees.
        overlays: see `overlay_file`.
        out: the new folder.

    Raises:
        BuildError: an overlay is malformed, or does not fit a device tree, or the board has none.
    """
    if not trees:
        raise BuildError(f"this board has no device trees to which {', '.join(overlays)} could apply")
    shutil.copytree(kernel_folder, out)
    with TemporaryDirectory() as folder:
        for number, name in enumerate(overlays):
            compiled = Path(folder) / f"{number}.dtbo"
            compile_overlay(name, compiled)
            for tree in trees:
                try:
                    run([tool("fdtoverlay"), "-i", out / tree, "-o", out / tree, compiled])
                except BuildError as error:
                    raise BuildError(f"the overlay {name} does not fit {tree}: {error}") from None
