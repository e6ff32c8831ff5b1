"""Lock files: the exact packages, wheels and kernel source of an image. They name no host."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import yaml
from pydantic import Field, NonNegativeInt, PositiveInt, ValidationError

from eal_actors.kernel.errors import ConfigError
from eal_actors.kernel.strict_model import StrictModel, Version1, problems_from
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
    """Which of the suite's archives offers it."""
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
    """The source of a Python package, which is compiled."""

    name: str
    version: str
    file: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.+!-]*\.tar\.gz$")]
    sha256: Sha256
    tools: Annotated[tuple[str, ...], Field(strict=False)]
    """What compiles it, with versions."""


class Lock(StrictModel):
    """All that an image is made of, but for this project's own files."""

    version: Version1
    platform: str
    image: str
    asked: Sha256
    """Of what the definitions asked for when this was written."""
    epoch: NonNegativeInt
    """When it was written, in seconds since 1970: the date of every file in the image."""
    kernel: LockedPackage
    packages: Annotated[tuple[LockedPackage, ...], Field(strict=False)]
    wheels: Annotated[tuple[LockedWheel, ...], Field(strict=False)]
    compiled: Annotated[tuple[LockedSource, ...], Field(strict=False)] = ()
    build_packages: Annotated[tuple[LockedPackage, ...], Field(strict=False)] = ()
    """What the build reads and the root does not hold: a sysroot, the board's first boot stages."""


def asked_by(platform: Platform, image: Image) -> str:
    """Return the hash of what decides which packages and wheels an image gets."""
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
    wanted.update({key: value for key, value in further.items() if value})
    return hashlib.sha256(json.dumps(wanted, sort_keys=True).encode()).hexdigest()


def lock_path(platform: Platform, image: Image, folder: Path = FOLDER) -> Path:
    """Return where the lock file of an image is."""
    kind = "" if isinstance(platform.kernel, Kernel) else "-packaged"
    return folder / f"{platform.name}-{image.name}{kind}.lock.yaml"


def read_lock(path: Path) -> Lock | None:
    """Return what a lock file says, or None if there is none.

    Raises:
        ConfigError: what is wrong with it.
    """
    if not path.is_file():
        return None
    tree = load_yaml(path)
    try:
        return Lock.model_validate(tree.root)
    except ValidationError as error:
        raise ConfigError(problems_from(error, tree, Lock)) from None


def write_lock(lock: Lock, path: Path) -> None:
    """Write a lock file: a line for each package, so that a change of one is a change of one line."""
    content: dict[str, Any] = lock.model_dump(mode="json")
    lines = ["# Written by `evbotos build --update-lock`; not meant to be edited."]
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
    """Return what a lock file says, which was written for these definitions.

    Raises:
        BuildError: there is none, or the definitions have changed since.
        ConfigError: what is wrong with it.
    """
    lock = read_lock(path)
    remedy = f"`evbotos build {platform.name} {image.name} --update-lock` writes it"
    if lock is None:
        raise BuildError(f"there is no {path.parent.name}/{path.name}; {remedy}")
    if lock.asked != asked_by(platform, image):
        raise BuildError(
            f"{path.name} was written for other packages, wheels or tags than {platform.name} and {image.name} ask for "
            f"now; {remedy} anew"
        )
    return lock
