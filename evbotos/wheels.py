"""Python packages for a platform, resolved and downloaded by pip, with dependencies that Debian lacks."""

from __future__ import annotations

import email
import re
import sys
import zipfile
from collections.abc import Iterable
from email.message import Message
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name, parse_wheel_filename

from evbotos.errors import BuildError
from evbotos.hashing import file_sha256
from evbotos.lock import LockedWheel
from evbotos.model import Platform
from evbotos.shell import run

_DEBIAN_NAMES: Final = {"python3-yaml": "pyyaml", "python3-cffi-backend": "cffi"}
"""Debian names that differ from `python3-<package>`."""
_MACHINES: Final = {"amd64": "x86_64", "arm64": "aarch64", "armhf": "armv7l", "i386": "i686"}
_MOST_ROUNDS: Final = 8


def provided_by(packages: Iterable[str]) -> set[str]:
    """Return the index names of the Python packages in Debian packages."""
    return {_DEBIAN_NAMES.get(name, name.removeprefix("python3-")) for name in packages if name.startswith("python3-")}


def resolve_wheels(platform: Platform, names: Iterable[str], provided: set[str]) -> list[LockedWheel]:
    """Return wheels with all dependencies, in the newest compatible versions.

    Args:
        platform: the target platform.
        names: the requested packages.
        provided: packages that Debian provides.

    Raises:
        BuildError: a package has no wheel for this platform.
    """
    absent = {canonicalize_name(name) for name in platform.compiled_wheels}
    wanted: dict[str, set[str]] = {canonicalize_name(Requirement(name).name): {name} for name in names}
    wanted = {name: demands for name, demands in wanted.items() if name not in absent}
    if not wanted:
        return []
    with TemporaryDirectory() as folder:
        for _ in range(_MOST_ROUNDS):
            for old in Path(folder).iterdir():
                old.unlink()
            _download(platform, sorted(demand for demands in wanted.values() for demand in demands), Path(folder))
            further = _further(Path(folder), wanted, provided, platform)
            if not further:
                return sorted(map(_locked, Path(folder).iterdir()), key=lambda wheel: wheel.name)
            for name, demand in further:
                wanted.setdefault(name, set()).add(demand)
    raise BuildError(f"the dependencies of the wheels for {platform.name} do not converge: {', '.join(sorted(wanted))}")


def fetch_wheels(platform: Platform, wheels: Iterable[LockedWheel], folder: Path) -> list[Path]:
    """Return the files of wheels from a cache keyed by hash; download missing ones.

    Raises:
        BuildError: a file is no longer offered, or does not match the lock.
    """
    found = {wheel: folder / wheel.sha256 / wheel.file for wheel in wheels}
    missing = [wheel for wheel, file in found.items() if not file.is_file() or file_sha256(file) != wheel.sha256]
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder, prefix=".part-") as part:
        if missing:
            _download(platform, [f"{wheel.name}=={wheel.version}" for wheel in missing], Path(part))
        for wheel in missing:
            file = Path(part) / wheel.file
            if not file.is_file() or file_sha256(file) != wheel.sha256:
                raise BuildError(
                    f"{wheel.file}, as locked, is unavailable; `evbotos build --update-lock` selects another"
                )
            found[wheel].parent.mkdir(exist_ok=True)
            file.replace(found[wheel])
    return list(found.values())


def _download(platform: Platform, demands: list[str], folder: Path) -> None:
    options = ["--no-deps", "--only-binary=:all:", "--python-version", platform.python, "--implementation", "cp"]
    for tag in platform.wheel_tags:
        options += ["--platform", tag]
    pip = [sys.executable, "-P", "-m", "pip", "--disable-pip-version-check"]
    run([*pip, "download", "--quiet", *options, "--dest", folder, *demands], timeout_s=900)


def _further(
    folder: Path, wanted: dict[str, set[str]], provided: set[str], platform: Platform
) -> list[tuple[str, str]]:
    """Return the further requirements of downloaded wheels, as name and requirement."""
    environment = {
        "python_version": platform.python,
        "python_full_version": f"{platform.python}.2",
        "platform_machine": _MACHINES[platform.architecture],
        "extra": "",
    }
    found: list[tuple[str, str]] = []
    for wheel in folder.iterdir():
        for line in metadata_of(wheel).get_all("Requires-Dist") or ():
            demand = Requirement(line)
            if demand.marker is not None and not demand.marker.evaluate(environment):
                continue
            name = canonicalize_name(demand.name)
            plain = f"{demand.name}{demand.specifier}"
            if name not in provided and plain not in wanted.get(name, ()):
                found.append((name, plain))
    return found


def metadata_of(wheel: Path) -> Message:
    """Return the METADATA of a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        name = next(name for name in archive.namelist() if re.fullmatch(r"[^/]+\.dist-info/METADATA", name))
        return email.message_from_bytes(archive.read(name))


def _locked(file: Path) -> LockedWheel:
    name, version, _, _ = parse_wheel_filename(file.name)
    return LockedWheel(name=str(name), version=str(version), file=file.name, sha256=file_sha256(file))
