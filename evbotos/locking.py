"""Locking: resolves the current versions of an image's contents from the archive and the package index."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Final

from eal_actors.kernel.clock import wall_time
from evbotos.compiled_wheels import SYSROOT, resolve_sources
from evbotos.errors import BuildError
from evbotos.interpreter import BUILD_MACHINES, interpreter_packages
from evbotos.lock import Lock, LockedPackage, asked_by, write_lock
from evbotos.model import Image, PackagedKernel, Platform
from evbotos.packages import Apt
from evbotos.plan import compiled_of, packages_of, wheels_of
from evbotos.wheels import provided_by, resolve_wheels

_KERNEL_IMAGE: Final = re.compile(r"linux-image-\d")


def lock_present_versions(
    platform: Platform, image: Image, apt_of: Callable[[str], Apt], old: Lock | None, path: Path
) -> Lock:
    """Return a lock of the current versions and write it; return the old lock if nothing changed.

    Args:
        platform: the board.
        image: the image definition.
        apt_of: returns the apt instance for an architecture.
        old: the previous lock.
        path: the lock file.

    Raises:
        BuildError: a package is unavailable, or versions conflict.
    """
    apt = apt_of(platform.architecture)
    apt.update()
    packages = tuple(apt.resolve(packages_of(platform, image)))
    wheels = resolve_wheels(platform, wheels_of(platform, image), provided_by(package.name for package in packages))
    sources = resolve_sources(platform, compiled_of(platform, image))
    new = Lock(
        version=1,
        platform=platform.name,
        image=image.name,
        asked=asked_by(platform, image),
        epoch=int(wall_time().timestamp()),
        kernel=_kernel_package(platform, apt),
        packages=packages,
        wheels=tuple(wheels),
        compiled=tuple(sources),
        build_packages=_build_packages(platform, apt, has_sysroot=bool(sources)),
        interpreter=tuple(_interpreter(platform, apt_of, compiles_wheels=bool(sources))),
    )
    if old is not None and old == new.model_copy(update={"epoch": old.epoch}):
        return old
    write_lock(new, path)
    return new


def _kernel_package(platform: Platform, apt: Apt) -> LockedPackage:
    """Return the package with the kernel or its source: the requested one, or the one with a version in its name."""
    origin = platform.kernel.origin
    is_packaged = isinstance(platform.kernel, PackagedKernel)
    for package in apt.resolve([origin]):
        if _KERNEL_IMAGE.match(package.name) if is_packaged else package.name == origin:
            return package
    raise BuildError(f"{origin} provides no kernel")


def _build_packages(platform: Platform, apt: Apt, *, has_sysroot: bool) -> tuple[LockedPackage, ...]:
    """Return the build inputs outside the root."""
    found = {package.name: package for package in apt.resolve(SYSROOT)} if has_sysroot else {}
    found |= _by_name(apt, platform.boot_packages)
    return tuple(found[name] for name in sorted(found))


def _interpreter(platform: Platform, apt_of: Callable[[str], Apt], *, compiles_wheels: bool) -> Iterator[LockedPackage]:
    """Yield the packages of the suite's Python for build machines."""
    for architecture in BUILD_MACHINES:
        apt = apt_of(architecture)
        apt.update()
        yield from _by_name(apt, interpreter_packages(platform.python, compiles_wheels=compiles_wheels)).values()


def _by_name(apt: Apt, names: Iterable[str]) -> dict[str, LockedPackage]:
    """Return packages without their dependencies."""
    return {package.name: package for name in names for package in apt.resolve([name]) if package.name == name}
