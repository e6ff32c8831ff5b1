"""The plan of a build: steps, packages, files and budgets."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from evbotos.disk import parts_of
from evbotos.fields import ROOTFS
from evbotos.hosttools import find_tool, needed_for
from evbotos.kernel import fragments_text
from evbotos.lock import Lock, asked_by
from evbotos.model import Image, Kernel, PackagedKernel, Platform


def layers_of(image: Image) -> list[Path]:
    """Return the folders to copy onto the root, in order: base, further files, services."""
    return [
        ROOTFS / "base",
        *(ROOTFS / name for name in image.files),
        *(ROOTFS / "services" / name for name in image.services),
    ]


def files_of(image: Image) -> list[str]:
    """Return the paths of the files that are copied onto the root."""
    names = set()
    for layer in layers_of(image):
        for path in layer.rglob("*"):
            if (path.is_file() or path.is_symlink()) and "__pycache__" not in path.parts:
                names.add(path.relative_to(layer).as_posix())
    return sorted(names - {"inittab"})


def packages_of(platform: Platform, image: Image) -> list[str]:
    """Return the requested Debian packages."""
    return sorted({*platform.packages, *image.packages})


def wheels_of(platform: Platform, image: Image) -> list[str]:
    """Return the requested Python packages."""
    return sorted(set(image.wheels) - set(platform.compiled_wheels))


def compiled_of(platform: Platform, image: Image) -> list[str]:
    """Return the Python packages to compile, because they have no wheel."""
    return sorted(set(image.wheels) & set(platform.compiled_wheels))


_BEFORE_DISK: Final = (
    "interpreter",
    "compiled",
    "kernel",
    "overlays",
    "base",
    "initrd",
    "root",
    "squash",
    "verity",
    "board",
    "grub",
)
_STEPS: Final = (*_BEFORE_DISK, "disk", "sizes", "bill", "emulator")


def make_plan(platform: Platform, image: Image, lock: Lock | None) -> dict[str, Any]:
    """Return the plan of a build as plain data.

    Args:
        platform: the board.
        image: the image definition.
        lock: its lock file, or None.
    """
    parts, kernel = parts_of(image.layout), platform.kernel
    return {
        "platform": platform.name,
        "image": image.name,
        "floor": platform.floor,
        "steps": _steps(platform, image),
        "packages": packages_of(platform, image),
        "wheels": wheels_of(platform, image),
        "compiled_wheels": compiled_of(platform, image),
        **_locked(lock, image),
        "lock_is_current": lock is not None and lock.asked == asked_by(platform, image),
        "services": list(image.services),
        "files": files_of(image),
        "kernel_options": fragments_text(kernel).count("CONFIG_") if isinstance(kernel, Kernel) else 0,
        "budget_mb": image.budget_mb.model_dump(),
        "disk_mib": parts.total >> 20,
        "missing_tools": [name for name in needed_for(platform) if find_tool(name) is None],
    }


def _locked(lock: Lock | None, image: Image) -> dict[str, Any]:
    """Return the part of a plan that the lock file determines; None for each value without one."""
    if lock is None:
        keys = ("locked_packages", "left_out_packages", "locked_wheels", "locked_compiled_wheels", "download_mb")
        return dict.fromkeys(keys)
    return {
        "locked_packages": [f"{one.name} {one.version}" for one in lock.packages if not image.leaves_out(one.name)],
        "left_out_packages": [f"{one.name} {one.version}" for one in lock.packages if image.leaves_out(one.name)],
        "locked_wheels": [f"{one.name} {one.version}" for one in lock.wheels],
        "locked_compiled_wheels": [f"{one.name} {one.version}" for one in lock.compiled],
        "download_mb": round(sum(package.size for package in lock.packages) / 1e6, 1),
    }


def step_names(platform: Platform, image: Image) -> list[str]:
    """Return the names of the steps of a build, in their order."""
    is_there = {
        "compiled": bool(compiled_of(platform, image)),
        "overlays": bool(platform.overlays),
        "initrd": isinstance(platform.kernel, PackagedKernel),
        "board": platform.loader == "u-boot",
        "grub": platform.loader == "grub",
        "emulator": platform.needs_stand_ins,
    }
    return [name for name in _STEPS if is_there.get(name, True)]


def _steps(platform: Platform, image: Image) -> list[str]:
    boot = {
        "grub": "GRUB before the first partition",
        "u-boot": "the ROM's boot files, U-Boot, its script, device trees",
        "none": "nothing: QEMU loads the kernel",
    }[platform.loader]
    kernel = platform.kernel
    if isinstance(kernel, Kernel):
        kernel_step = f"kernel: build {kernel.source} for {kernel.architecture}"
    else:
        kernel_step = f"kernel: unpack {kernel.package}, with an initial RAM disk of {', '.join(kernel.modules)}"
    compiled = compiled_of(platform, image)
    trees = [f"overlays: apply {', '.join(platform.overlays)} to the device trees"] if platform.overlays else []
    cross = [f"compiled: compile wheels of {', '.join(compiled)} from source"] if compiled else []
    stand_ins = ["emulator: QEMU's substitutes for the board's ROM and device tree"] if platform.needs_stand_ins else []
    return [
        f"packages: fetch {platform.architecture} packages of {platform.suite}, by their locked hashes",
        "wheels: fetch Python packages, by their locked hashes",
        *cross,
        kernel_step,
        *trees,
        "base: unpack, prune, compile Python, check for missing libraries",
        f"root: add {', '.join(image.services)}" + (", and this project" if image.project else ""),
        f"squash: compress with {image.compression}",
        "verity: append the hash tree with which the kernel verifies each block",
        f"disk: boot partition, slots A and B, data; to start it: {boot}",
        *stand_ins,
        "outputs: manifest, bill of materials, sizes",
    ]
