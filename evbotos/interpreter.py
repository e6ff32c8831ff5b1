"""The Python that compiles for an image: the suite's own, for the build machine, in a folder.

The dynamic loader of the suite's C library runs it, so that the build machine may have any other Python, and every one
makes the same files.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final

from evbotos.errors import BuildError
from evbotos.hosttools import tool
from evbotos.lock import LockedPackage
from evbotos.shell import run

BUILD_MACHINES: Final = ("amd64", "arm64")
"""Architectures of build machines, by Debian's names."""


def interpreter_packages(python: str, *, compiles_wheels: bool) -> tuple[str, ...]:
    """Return the Debian packages of a Python of a version, such as `3.13`, that compiles Python files.

    Args:
        python: the version.
        compiles_wheels: with the library of which the build of a wheel needs parts.
    """
    library = (f"libpython{python}-stdlib",) if compiles_wheels else ()
    return ("libc6", "libexpat1", f"libpython{python}-minimal", *library, f"python{python}-minimal", "zlib1g")


def of_this_machine(packages: Iterable[LockedPackage]) -> list[LockedPackage]:
    """Return the packages for the build machine's architecture.

    Raises:
        BuildError: there are none.
    """
    architecture = run([tool("dpkg"), "--print-architecture"]).strip()
    found = [package for package in packages if package.path.endswith(f"_{architecture}.deb")]
    if not found:
        raise BuildError(f"there is no Python for a build machine of {architecture}, only for {BUILD_MACHINES}")
    return found


def command_of(interpreter: Path) -> list[str | Path]:
    """Return the first words of a command that runs the Python in a folder."""
    (loader,) = interpreter.glob("usr/lib/*/ld-linux-*.so.*")
    (program,) = interpreter.glob("usr/bin/python3.*")
    return [loader, "--library-path", loader.parent, program]
