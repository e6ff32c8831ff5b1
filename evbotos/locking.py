"""Locking: resolves the current versions of an image's contents from the archive and the package index."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from eal_actors.kernel.clock import wall_time
from evbotos.compiled_wheels import SYSROOT, resolve_sources
from evbotos.errors import BuildError
from evbotos.lock import Lock, LockedPackage, asked_by, write_lock
from evbotos.model import Image, PackagedKernel, Platform
from evbotos.packages import Apt
from evbotos.plan import compiled_of, packages_of, wheels_of
from evbotos.wheels import provided_by, resolve_wheels

_KERNEL_IMAGE: Final = re.compile(r"linux-image-\d")


def lock_present_versions(
    platform: Platform, image: Image, apt: Apt, board_apt: Apt, old: Lock | None, path: Path
) -> Lock:
    """Return a lock of the current versions and write it; return the old lock if nothing changed.

    Args:
        platform: the board.
        image: the image definition.
        apt: the apt instance for the platform's architecture.
        board_apt: that of its `board_suite`, which may be the same.
        old: the previous lock.
        path: the lock file.

    Raises:
        BuildError: a package is unavailable, or versions conflict.
    """
    apt.update()
    if board_apt is not apt:
        board_apt.update()
    packages = _root_packages(platform, image, apt, board_apt)
    wheels = resolve_wheels(platform, wheels_of(platform, image), provided_by(package.name for package in packages))
    sources = resolve_sources(platform, compiled_of(platform, image))
    new = Lock(
        version=1,
        platform=platform.name,
        image=image.name,
        asked=asked_by(platform, image),
        epoch=int(wall_time().timestamp()),
        kernel=_kernel_package(platform, board_apt),
        packages=packages,
        wheels=tuple(wheels),
        compiled=tuple(sources),
        build_packages=_build_packages(platform, apt, board_apt, has_sysroot=bool(sources)),
    )
    if old is not None and old == new.model_copy(update={"epoch": old.epoch}):
        return old
    write_lock(new, path)
    return new


def _root_packages(platform: Platform, image: Image, apt: Apt, board_apt: Apt) -> tuple[LockedPackage, ...]:
    found = {package.name: package for package in apt.resolve(packages_of(platform, image))}
    found |= _by_name(board_apt, (name for name in platform.firmware if name in found))
    return tuple(found.values())


def _kernel_package(platform: Platform, apt: Apt) -> LockedPackage:
    """Return the package with the kernel or its source: the requested one, or the one with a version in its name."""
    origin = platform.kernel.origin
    is_packaged = isinstance(platform.kernel, PackagedKernel)
    for package in apt.resolve([origin]):
        if _KERNEL_IMAGE.match(package.name) if is_packaged else package.name == origin:
            return package
    raise BuildError(f"{origin} provides no kernel")


def _build_packages(platform: Platform, apt: Apt, board_apt: Apt, *, has_sysroot: bool) -> tuple[LockedPackage, ...]:
    """Return the build inputs outside the root."""
    found = {package.name: package for package in apt.resolve(SYSROOT)} if has_sysroot else {}
    found |= _by_name(board_apt, platform.boot_packages)
    return tuple(found[name] for name in sorted(found))


def _by_name(apt: Apt, names: Iterable[str]) -> dict[str, LockedPackage]:
    """Return packages without their dependencies."""
    return {package.name: package for name in names for package in apt.resolve([name]) if package.name == name}
