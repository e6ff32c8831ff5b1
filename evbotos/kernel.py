"""Kernels compiled from Debian's source: small, without modules and initial RAM disk."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Final

from evbotos.errors import BuildError
from evbotos.fields import FRAGMENTS
from evbotos.hosttools import tool
from evbotos.model import Kernel
from evbotos.shell import run

CONFIG: Final = "config"
_WORK: Final = "kernel-work-"
"""The beginning of the folder in which a kernel is compiled; a killed build leaves it, and the next one resumes."""
_LONGEST_S: Final = 86_400.0
"""The limit of a compilation in real seconds: it takes minutes, but hours on a busy computer or a small one."""
_REPRODUCIBLE: Final = {"KBUILD_BUILD_USER": "evbotos", "KBUILD_BUILD_HOST": "evbotos", "KBUILD_BUILD_VERSION": "1"}


def fragments_text(kernel: Kernel) -> str:
    """Return our part of a kernel's configuration."""
    return "".join((FRAGMENTS / name).read_text() for name in kernel.fragments)


def refused_options(wanted: str, config: str) -> list[str]:
    """Return the requested options that a configuration lacks: misspelt, or with unmet dependencies."""
    has = set(config.splitlines())
    options = dict(line.split("=", 1) for line in wanted.splitlines() if line.startswith("CONFIG_"))
    return [
        f"{name}={value}"
        for name, value in options.items()
        if (f"{name}={value}" not in has if value != "n" else any(line.startswith(f"{name}=") for line in has))
    ]


def build_kernel(kernel: Kernel, source: Path, out: Path, work: Path) -> None:
    """Build a kernel and its device trees into a folder.

    Args:
        kernel: the kernel definition.
        source: the source package.
        out: the output folder for image, device trees and configuration.
        work: a folder with about 2 GB of space for the source.

    Raises:
        BuildError: an option is refused, or the compilation fails.
    """
    folder = work / f"{_WORK}{out.name.removeprefix('.part-')}"
    for other in work.glob(f"{_WORK}*"):
        if other != folder:
            shutil.rmtree(other)  # of a build that was given up
    tree, date = _unpacked(source, folder)
    _compile(kernel, tree, date, out)
    shutil.rmtree(folder)


def _compile(kernel: Kernel, tree: Path, date: int, out: Path) -> None:
    """Compile, or go on where a killed build ended: make skips the finished objects."""
    make = [tool("make"), "-s", f"ARCH={kernel.architecture}", f"-j{os.cpu_count() or 1}"]
    if kernel.cross is not None:
        make.append(f"CROSS_COMPILE={kernel.cross}")
    stamp = {"KBUILD_BUILD_TIMESTAMP": f"@{date}", **_REPRODUCIBLE}
    run([*make, kernel.base], cwd=tree, env=stamp)
    wanted = fragments_text(kernel)
    with (tree / ".config").open("a") as file:
        file.write(wanted)
    run([*make, "olddefconfig"], cwd=tree, env=stamp)
    refused = refused_options(wanted, (tree / ".config").read_text())
    if refused:
        raise BuildError(f"the kernel refuses these options: {', '.join(refused)}")
    trees = [f"arch/{kernel.architecture}/boot/dts/{name}" for name in kernel.device_trees]
    wanted_files = [Path(kernel.image).name, *(name.partition("/dts/")[2] for name in trees)]
    run([*make, *wanted_files], cwd=tree, env=stamp, timeout_s=_LONGEST_S)
    out.mkdir(parents=True)
    for name in (kernel.image, *trees, ".config"):
        shutil.copy(tree / name, out / (Path(name).name if name != ".config" else CONFIG))


def _unpacked(source: Path, folder: Path) -> tuple[Path, int]:
    """Return the folder of the source and its date; a source that an earlier build has unpacked is used again."""
    done = folder / "unpacked"
    if not done.is_file():
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        tree, date = _unpack(source, folder)
        done.write_text(f"{tree.name} {date}\n")
    name, date_text = done.read_text().split()
    return folder / name, int(date_text)


def _unpack(source: Path, folder: Path) -> tuple[Path, int]:
    """Return the folder of the unpacked source and the kernel's date, which makes builds reproducible."""
    run([tool("dpkg-deb"), "-x", source, folder / "package"])
    archives = list((folder / "package/usr/src").glob("linux-source-*.tar.xz"))
    if len(archives) != 1:
        raise BuildError(f"{source.name} does not contain a kernel source")
    run([tool("tar"), "-xf", archives[0], "-C", folder])
    return folder / archives[0].name.removesuffix(".tar.xz"), int(archives[0].stat().st_mtime)
