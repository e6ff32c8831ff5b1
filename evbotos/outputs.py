"""The output of a build: disk images, root, kernel, a manifest, a bill of materials."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import eal_actors
from evbotos import slots, verity
from evbotos.errors import BuildError
from evbotos.hashing import file_sha256
from evbotos.lock import Lock
from evbotos.model import Image, Platform
from evbotos.qemu import DEVICE_TREE, LOADER
from evbotos.steps import StepDone, place


@dataclass(frozen=True, slots=True)
class Built:
    """The result of a build.

    Attributes:
        folder: the output folder.
        report: sizes, hashes, steps and warnings, as plain data.
    """

    folder: Path
    report: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Made:
    """The paths of the steps' results.

    Attributes:
        root: a folder with the compressed root and its hash tree.
        kernel: a folder with the kernel and its device trees.
        disks: a folder with `disk.img`, and `boot.img` for boards with GRUB.
        sizes: the size by component.
        bill: the bill of materials.
        initrd: the initial RAM disk of a packaged kernel, or None.
        emulator: a folder with QEMU's boot loader and device tree; None for a PC.
    """

    root: Path
    kernel: Path
    disks: Path
    sizes: Path
    bill: Path
    initrd: Path | None
    emulator: Path | None


def manifest_of(lock: Lock, image: Image) -> dict[str, Any]:
    """Return the manifest in an image: its contents with versions."""
    left_out = [item.name for item in lock.packages if image.leaves_out(item.name)]
    return {
        "platform": lock.platform,
        "image": lock.image,
        "eal_actors": eal_actors.__version__,
        "epoch": lock.epoch,
        "release": slots.release_of(eal_actors.__version__, lock.epoch),
        "kernel": lock.kernel.version,
        "packages": {item.name: item.version for item in lock.packages if item.name not in left_out},
        "left_out": sorted(left_out),
        "wheels": {item.name: item.version for item in lock.wheels},
        "compiled": {item.name: item.version for item in lock.compiled},
    }


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Name the output folder in errors of a `with` block that writes to it.

    Raises:
        BuildError: it cannot be written.
    """
    try:
        yield
    except OSError as error:
        raise BuildError(f"{folder} cannot be written: {error.strerror or error}") from error


def write_outputs(
    platform: Platform,
    image: Image,
    lock: Lock,
    made: Made,
    steps: Sequence[StepDone],
    warnings: list[str],
    folder: Path,
) -> Built:
    """Copy the results to the output folder and write the reports.

    Args:
        platform: the board.
        image: the image definition.
        lock: the lock of the image.
        made: the results of the steps.
        steps: the executed steps.
        warnings: the warnings of the build.
        folder: the output folder.

    Raises:
        BuildError: the folder cannot be written.
    """
    sources: dict[str, Path | None] = {
        "root.squashfs": made.root / verity.ROOT,
        "kernel": made.kernel / platform.kernel.file,
        "disk.img": made.disks / "disk.img",
        "boot.img": made.disks / "boot.img",
        "sizes.json": made.sizes,
        "sbom.cdx.json": made.bill,
        "initrd": made.initrd,
        **{name: made.emulator and made.emulator / name for name in (LOADER, DEVICE_TREE)},
    }
    with writing(folder):
        for name, source in sources.items():
            if source is not None and source.exists():
                place(source, folder / name)
            else:  # an earlier build may have created it
                (folder / name).unlink(missing_ok=True)
    files = {name: folder / name for name in ("root.squashfs", "kernel", "disk.img")}
    report = {
        **manifest_of(lock, image),
        "files": {
            name: {"mb": round(path.stat().st_size / 1e6, 2), "sha256": file_sha256(path)}
            for name, path in files.items()
        },
        "verity": asdict(verity.read_verity(made.root)),
        "root_with_kernel_mb": round(root_with_kernel_mb(made, platform), 2),
        "budget_mb": image.budget_mb.root_with_kernel,
        "steps": [asdict(step) for step in steps],
        "warnings": warnings,
    }
    (folder / "manifest.json").write_text(json.dumps(report, indent=1) + "\n")
    return Built(folder, report)


def root_with_kernel_mb(made: Made, platform: Platform) -> float:
    """Return the size of root and kernel in MB (10^6 bytes)."""
    return ((made.root / verity.ROOT).stat().st_size + (made.kernel / platform.kernel.file).stat().st_size) / 1e6
