"""What a build would do, without doing it: steps, packages, files and budgets."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from evbotos.disk import parts_of
from evbotos.hosttools import find_tool, needed_for
from evbotos.kernel import fragments_text
from evbotos.lock import Lock, asked_by
from evbotos.model import Image, Kernel, Platform

ROOTFS: Final = Path(__file__).parent / "rootfs"


def layers_of(image: Image, rootfs: Path = ROOTFS) -> list[Path]:
    """Return the folders that are laid over the root, in order: the base, further files, the services."""
    return [
        rootfs / "base",
        *(rootfs / name for name in image.files),
        *(rootfs / "services" / name for name in image.services),
    ]


def files_of(image: Image, rootfs: Path = ROOTFS) -> list[str]:
    """Return the files that are laid over the root, by their place in it."""
    names = set()
    for layer in layers_of(image, rootfs):
        for path in layer.rglob("*"):
            if (path.is_file() or path.is_symlink()) and "__pycache__" not in path.parts:
                names.add(path.relative_to(layer).as_posix())
    return sorted(names - {"inittab"})


def packages_of(platform: Platform, image: Image) -> list[str]:
    """Return the Debian packages that are asked for."""
    return sorted({*platform.packages, *image.packages})


def wheels_of(platform: Platform, image: Image) -> list[str]:
    """Return the Python packages that are asked for."""
    return sorted(set(image.wheels) - set(platform.compiled_wheels))


def compiled_of(platform: Platform, image: Image) -> list[str]:
    """Return the Python packages that are compiled, for want of a wheel."""
    return sorted(set(image.wheels) & set(platform.compiled_wheels))


def make_plan(platform: Platform, image: Image, lock: Lock | None) -> dict[str, Any]:
    """Return the plan of a build as plain data.

    Args:
        platform: the board.
        image: what goes onto it.
        lock: its lock file, if there is one.
    """
    parts, kernel = parts_of(image.layout), platform.kernel
    left_out = set(image.drop_packages)
    locked = [f"{package.name} {package.version}" for package in lock.packages] if lock is not None else None
    return {
        "platform": platform.name,
        "image": image.name,
        "floor": platform.floor,
        "steps": _steps(platform, image),
        "packages": packages_of(platform, image),
        "locked_packages": locked and [name for name in locked if name.split()[0] not in left_out],
        "left_out_packages": locked and [name for name in locked if name.split()[0] in left_out],
        "wheels": wheels_of(platform, image),
        "compiled_wheels": compiled_of(platform, image),
        "locked_wheels": None if lock is None else [f"{wheel.name} {wheel.version}" for wheel in lock.wheels],
        "locked_compiled_wheels": None if lock is None else [f"{one.name} {one.version}" for one in lock.compiled],
        "lock_is_current": lock is not None and lock.asked == asked_by(platform, image),
        "download_mb": None if lock is None else round(sum(package.size for package in lock.packages) / 1e6, 1),
        "services": list(image.services),
        "files": files_of(image),
        "kernel_options": fragments_text(kernel).count("CONFIG_") if isinstance(kernel, Kernel) else 0,
        "budget_mb": image.budget_mb.model_dump(),
        "disk_mib": parts.total >> 20,
        "missing_tools": [name for name in needed_for(platform) if find_tool(name) is None],
    }


def _steps(platform: Platform, image: Image) -> list[str]:
    boot = {
        "grub": "GRUB before the first partition",
        "u-boot": "what the board's ROM reads first, U-Boot, its script, device trees",
        "none": "nothing: the kernel is loaded from outside",
    }[platform.loader]
    kernel = platform.kernel
    if isinstance(kernel, Kernel):
        kernel_step = f"kernel: build {kernel.source} for {kernel.architecture}"
    else:
        kernel_step = f"kernel: unpack {kernel.package}, with an initial RAM disk of {', '.join(kernel.modules)}"
    compiled = compiled_of(platform, image)
    cross = [f"compiled: compile wheels of {', '.join(compiled)} from source"] if compiled else []
    stand_ins = (
        ["emulator: what QEMU has in place of the board's ROM and device tree"] if platform.needs_stand_ins else []
    )
    return [
        f"packages: fetch {platform.architecture} packages of {platform.suite}, by their locked hashes",
        "wheels: fetch Python packages, by their locked hashes",
        *cross,
        kernel_step,
        "base: unpack, leave out what is pruned, compile Python, look for missing libraries",
        f"root: lay {', '.join(image.services)} over it" + (", and this project" if image.project else ""),
        f"squash: compress with {platform.compression}",
        f"disk: boot partition, slots A and B, data; to start it: {boot}",
        *stand_ins,
        "outputs: manifest, bill of materials, sizes",
    ]
