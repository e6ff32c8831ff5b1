"""Lock files: the exact packages, wheels and kernel source of an image, without host names."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import yaml
from pydantic import Field, NonNegativeInt, PositiveInt

from eal_actors.kernel.strict_model import StrictModel, Version1, model_of
from eal_actors.kernel.yaml_source import load_yaml
from evbotos.errors import BuildError
from evbotos.model import Image, Kernel, Platform

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Archive = Literal["main", "updates", "security"]

FOLDER: Final = Path(__file__).parent / "locks"


class LockedPackage(StrictModel):
    """One Debian package."""

    name: str
    version: str
    archive: Archive
    """The suite's archive that offers it."""
    path: Annotated[str, Field(pattern=r"^pool/")]
    """In its archive."""
    size: PositiveInt
    sha256: Sha256


class LockedWheel(StrictModel):
    """One wheel."""

    name: str
    version: str
    file: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.+!-]*\.whl$")]
    sha256: Sha256


class LockedSource(StrictModel):
    """The source of a Python package to compile."""

    name: str
    version: str
    file: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.+!-]*\.tar\.gz$")]
    sha256: Sha256
    tools: Annotated[tuple[str, ...], Field(strict=False)]
    """Its build tools with versions."""


class Lock(StrictModel):
    """All contents of an image except this project's own files."""

    version: Version1
    platform: str
    image: str
    asked: Sha256
    """The hash of the definitions at the time of locking."""
    epoch: NonNegativeInt
    """The time of locking in seconds since 1970: the date of every file in the image."""
    kernel: LockedPackage
    packages: Annotated[tuple[LockedPackage, ...], Field(strict=False)]
    wheels: Annotated[tuple[LockedWheel, ...], Field(strict=False)]
    compiled: Annotated[tuple[LockedSource, ...], Field(strict=False)] = ()
    build_packages: Annotated[tuple[LockedPackage, ...], Field(strict=False)] = ()
    """Build inputs outside the root: a sysroot, the board's first boot stages."""
    interpreter: Annotated[tuple[LockedPackage, ...], Field(strict=False)]
    """The suite's Python for build machines, which compiles the image's Python."""


def asked_by(platform: Platform, image: Image) -> str:
    """Return the hash of everything that determines an image's packages and wheels."""
    wanted: dict[str, object] = {
        "architecture": platform.architecture,
        "suite": platform.suite,
        "packages": sorted({*platform.packages, *image.packages}),
        "wheels": sorted(set(image.wheels) - set(platform.compiled_wheels)),
        "tags": list(platform.wheel_tags),
        "kernel": platform.kernel.origin,
    }
    compiled = {name: list(by) for name, by in platform.compiled_wheels.items() if name in image.wheels}
    further: dict[str, object] = {"compiled": compiled, "boot_files": list(platform.boot_packages)}
    further["backports"] = list(platform.backports)
    wanted.update({key: value for key, value in further.items() if value})
    return hashlib.sha256(json.dumps(wanted, sort_keys=True).encode()).hexdigest()


def lock_path(platform: Platform, image: Image, folder: Path = FOLDER) -> Path:
    """Return the path of an image's lock file."""
    kind = "" if isinstance(platform.kernel, Kernel) else "-packaged"
    return folder / f"{platform.name}-{image.name}{kind}.lock.yaml"


def read_lock(path: Path) -> Lock | None:
    """Return a lock file's content, or None without a file.

    Raises:
        ConfigError: the file is invalid.
    """
    if not path.is_file():
        return None
    tree = load_yaml(path)
    return model_of(Lock, tree)


def write_lock(lock: Lock, path: Path) -> None:
    """Write a lock file with one line per package, for readable diffs."""
    content: dict[str, Any] = lock.model_dump(mode="json")
    lines = ["# Written by `evbotos build --update-lock`; do not edit."]
    for key, value in content.items():
        if isinstance(value, list):
            lines += [f"{key}:" if value else f"{key}: []", *(f"  - {_flow(item)}" for item in value)]
        else:
            lines.append(f"{key}: {_flow(value)}")
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    part.write_text("\n".join(lines) + "\n")
    part.replace(path)


def _flow(value: object) -> str:
    if not isinstance(value, dict):
        return json.dumps(value)
    return str(yaml.safe_dump(value, default_flow_style=True, width=10_000, sort_keys=False)).strip()


def require_lock(path: Path, platform: Platform, image: Image) -> Lock:
    """Return the content of a lock file that matches the definitions.

    Raises:
        BuildError: the file is missing or outdated.
        ConfigError: the file is invalid.
    """
    lock = read_lock(path)
    remedy = f"`evbotos build {platform.name} {image.name} --update-lock` writes it"
    if lock is None:
        raise BuildError(f"there is no {path.parent.name}/{path.name}; {remedy}")
    if lock.asked != asked_by(platform, image):
        raise BuildError(
            f"{path.name} is outdated: {platform.name} and {image.name} now request other packages, wheels or tags; "
            f"{remedy}"
        )
    return lock
