"""Python packages without a wheel for a platform, compiled from source with the sysroot of its SDK."""

from __future__ import annotations

import os
import sys
import tarfile
from collections.abc import Iterable
from importlib.metadata import distributions
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from packaging.utils import canonicalize_name, parse_sdist_filename

from evbotos.errors import BuildError
from evbotos.hashing import file_sha256
from evbotos.interpreter import command_of
from evbotos.lock import LockedSource
from evbotos.model import Platform
from evbotos.sdk import ENVIRONMENT, environment_text, make_sysroot, python_of
from evbotos.shell import run

SYSROOT: Final = ("libc6-dev", "libpython3-dev")
"""Debian packages of the sysroot, in addition to their dependencies."""
_PIP: Final = (sys.executable, "-P", "-m", "pip", "--disable-pip-version-check", "--quiet")
_BUILD: Final = "import sys; from setuptools import build_meta; build_meta.build_wheel(sys.argv[1])"
_COMPILE: Final = (
    'EVBOTOS_SDK="$1" && . "$1/environment" && export CFLAGS="$CFLAGS $PYTHON_CFLAGS" && shift && exec "$@"'
)


def resolve_sources(platform: Platform, names: Iterable[str]) -> list[LockedSource]:
    """Return the newest sources of Python packages, with the versions of their build tools.

    Raises:
        BuildError: a source or a build tool is missing.
    """
    found = []
    for name in names:
        with TemporaryDirectory() as folder:
            source = _download(name, name, Path(folder))
            tools = Path(folder) / "tools"
            _install(platform, platform.compiled_wheels[name], tools)
            versions = sorted(f"{one.name}=={one.version}" for one in distributions(path=[str(tools)]))
            _, version = parse_sdist_filename(source.name)
            found.append(
                LockedSource(
                    name=canonicalize_name(name),
                    version=str(version),
                    file=source.name,
                    sha256=file_sha256(source),
                    tools=tuple(versions),
                )
            )
    return found


def fetch_sources(sources: Iterable[LockedSource], folder: Path) -> list[Path]:
    """Return the files of sources from a cache keyed by hash; download missing ones.

    Raises:
        BuildError: a file is no longer offered, or does not match the lock.
    """
    files = []
    for source in sources:
        file = folder / source.sha256 / source.file
        files.append(file)
        if file.is_file():
            continue
        file.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(dir=folder, prefix=".part-") as part:
            got = _download(source.name, f"{source.name}=={source.version}", Path(part))
            if file_sha256(got) != source.sha256:
                raise BuildError(
                    f"{source.file}, as locked, is unavailable; `evbotos build --update-lock` selects another"
                )
            got.replace(file)
    return files


def _download(name: str, demand: str, folder: Path) -> Path:
    run([*_PIP, "download", "--no-deps", f"--no-binary={name}", "--dest", folder, demand], timeout_s=900)
    found = list(folder.glob("*.tar.gz"))
    if len(found) != 1:
        raise BuildError(f"{demand} has no source that pip can compile")
    return found[0]


def _install(platform: Platform, tools: Iterable[str], folder: Path) -> None:
    """Install build tools for the Python of the platform's suite on the build machine."""
    python = ["--only-binary=:all:", "--implementation", "cp", "--python-version", platform.python]
    machine = ["--platform", f"manylinux2014_{os.uname().machine}"]
    run([*_PIP, "install", *python, *machine, "--target", folder, *tools], timeout_s=900)


def compile_wheels(
    platform: Platform,
    sources: Iterable[tuple[LockedSource, Path]],
    debs: Iterable[Path],
    interpreter: Path,
    out: Path,
    epoch: int,
) -> None:
    """Compile wheels of Python packages for a platform, reproducibly.

    Args:
        platform: the target platform.
        sources: the locked sources with their files.
        debs: the package files of the sysroot.
        interpreter: the tree of the suite's Python for the build machine.
        out: the output folder.
        epoch: the date of every file.

    Raises:
        BuildError: a package does not compile.
    """
    out.mkdir(parents=True)
    with TemporaryDirectory(dir=out.parent, prefix=".part-compile-") as name:
        work = Path(name)
        sdk = work / "sdk"
        sysroot = sdk / "sysroot"
        sysroot.mkdir(parents=True)
        make_sysroot(debs, sysroot)
        (sdk / ENVIRONMENT).write_text(environment_text(platform, python_of(sysroot)))
        for locked, file in sources:
            _compile(platform, locked, file, sdk, interpreter, out, epoch)


def _compile(
    platform: Platform, locked: LockedSource, file: Path, sdk: Path, interpreter: Path, out: Path, epoch: int
) -> None:
    work = sdk.parent / locked.name
    tools = work / "tools"
    _install(platform, locked.tools, tools)
    with tarfile.open(file) as archive:
        archive.extractall(work, filter="data")
    settings = next((sdk / "sysroot").glob("usr/lib/python3*/_sysconfigdata__*-*.py"))
    env = {
        "PYTHONPATH": f"{tools}:{settings.parent}",
        "_PYTHON_SYSCONFIGDATA_NAME": settings.stem,
        "SOURCE_DATE_EPOCH": str(epoch),
        "PYTHONHASHSEED": "0",
    }
    words: list[str | Path] = ["sh", "-c", _COMPILE, "sh", sdk, *command_of(interpreter), "-S", "-c", _BUILD, out]
    run(words, cwd=work / file.name.removesuffix(".tar.gz"), env=env)
