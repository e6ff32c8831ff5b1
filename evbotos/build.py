"""The build: from definitions and a lock file to a disk image."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final

from evbotos import (
    bytecode,
    compiled_wheels,
    disk,
    grub,
    kernel,
    licences,
    overlays,
    packaged_kernel,
    project,
    pruning,
    qemu,
    sbom,
    sizes,
    slimming,
    slots,
    squash,
    targets,
    tree,
    u_boot,
    verity,
)
from evbotos.errors import BuildError
from evbotos.hashing import file_sha256, files_sha256, key_of
from evbotos.hosttools import needed_for, require
from evbotos.interpreter import of_this_machine
from evbotos.lock import Lock, LockedPackage, read_lock, require_lock
from evbotos.locking import lock_present_versions
from evbotos.model import Image, Kernel, Local, PackagedKernel, Platform
from evbotos.outputs import Built, Made, manifest_of, root_with_kernel_mb, write_outputs, writing
from evbotos.packages import Apt, apt_for
from evbotos.plan import layers_of, step_names
from evbotos.robot_files import gather_robot_files
from evbotos.steps import Runner, Step, owned
from evbotos.wheels import fetch_wheels

OUTPUT: Final = Path("build/evbotos")
_FOLDERS: Final = (
    "proc",
    "sys",
    "dev",
    "run",
    "tmp",
    "data",
    "boot",
    "media",
    "ro",
    "root",
    "var/log",
    "var/lib",
    "mnt",
)
_OWN: Final = f"{tree.SITE}/eal_actors"
"""Compiled like the rest, except plugins: the framework finds them by their source files."""
_PACKAGED: Final = Path(str(packaged_kernel.__file__))


def cache_folder(local: Local) -> Path:
    """Return the folder of the cache: the user's choice, else the user's cache folder."""
    if local.cache is not None:
        return Path(local.cache).expanduser()
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(base).expanduser() / "evbotos"


def kernel_key(platform: Platform, lock: Lock) -> str:
    """Return the cache key of a platform's kernel."""
    wanted = platform.kernel
    fragments = kernel.fragments_text(wanted) if isinstance(wanted, Kernel) else file_sha256(_PACKAGED)
    return key_of([lock.kernel.sha256, wanted.model_dump(mode="json"), fragments])


class Build:
    """One build.

    Args:
        image: the image definition.
        local: the user's settings.
        lock_file: the lock file.
        tell: receives each executed step and each warning.
    """

    def __init__(
        self, platform: Platform, image: Image, local: Local, lock_file: Path, tell: Callable[[str], None]
    ) -> None:
        self._platform = platform
        self._image = image
        self._local = local
        self._tell = tell
        self._cache = cache_folder(local)
        self.runner: Final = Runner(self._cache, tell, step_names(platform, image))
        self._warnings: list[str] = []
        self._lock_file = lock_file

    def run(self, output: Path, *, update_lock: bool = False) -> Built:
        """Build the image, reusing cached steps.

        Args:
            output: parent of the folder for this platform and image.
            update_lock: resolve the current versions and write the lock file.

        Raises:
            BuildError: a step failed, or the lock file does not fit.
            MissingToolsError: lists all programs that are not installed.
            ConfigError: the lock file is invalid.
        """
        require(needed_for(self._platform))
        folder = output / f"{self._platform.name}-{self._image.name}"
        with writing(folder):  # before minutes of work
            folder.mkdir(parents=True, exist_ok=True)
        with owned(self._cache):
            lock = self._lock(update_lock)
            interpreter = self.runner.run(self._interpreter_step(lock))
            debs, wheels = self._fetch(lock, interpreter)
            kernel_folder = self.runner.run(self._kernel_step(lock))
            if self._platform.overlays:
                kernel_folder = self.runner.run(self._overlays_step(kernel_folder))
            base = self.runner.run(self._base_step(lock, debs, wheels, interpreter))
            initrd = self.runner.run(self._initrd_step(lock, kernel_folder, base)) if self._is_packaged else None
            root = self.runner.run(self._root_step(lock, base, interpreter))
            squashed = self.runner.run(self._squash_step(lock, root))
            verified = self.runner.run(self._verity_step(squashed))
            loader, needs_stand_ins = self._platform.loader, self._platform.needs_stand_ins
            board = self.runner.run(self._board_step(lock, kernel_folder)) if loader == "u-boot" else None
            images = self.runner.run(self._grub_step(lock)) if loader == "grub" else None
            made = Made(
                root=verified,
                kernel=kernel_folder,
                disks=self.runner.run(self._disk_step(lock, verified, kernel_folder, board, images)),
                sizes=self.runner.run(self._sizes_step(root)),
                bill=self.runner.run(self._bill_step(lock, debs, wheels)),
                initrd=initrd,
                emulator=self.runner.run(self._emulator_step(lock, kernel_folder)) if needs_stand_ins else None,
            )
            self._see_to_the_budget(root_with_kernel_mb(made, self._platform))
            return write_outputs(self._platform, self._image, lock, made, self.runner.done, self._warnings, folder)

    def _warn(self, words: str) -> None:
        self._warnings.append(words)
        self._tell(f"warning: {words}")

    def _see_to_the_budget(self, taken_mb: float) -> None:
        if taken_mb > (budget_mb := self._image.budget_mb.root_with_kernel):
            self._warn(f"root and kernel take {taken_mb:.1f} MB, over the budget of {budget_mb:g} MB")

    def _apt(self, architecture: str) -> Apt:
        return apt_for(self._platform, architecture, self._local.mirror, self._cache, self._warn)

    def _debs(self, packages: Iterable[LockedPackage]) -> list[Path]:
        return self._apt(self._platform.architecture).fetch(packages, self._cache / "debs")

    def _lock(self, update: bool) -> Lock:
        if not update:
            return require_lock(self._lock_file, self._platform, self._image)
        self._tell("lock: resolving the current versions")
        return lock_present_versions(
            self._platform, self._image, self._apt, read_lock(self._lock_file), self._lock_file
        )

    @property
    def _is_packaged(self) -> bool:
        return isinstance(self._platform.kernel, PackagedKernel)

    def _fetch(self, lock: Lock, interpreter: Path) -> tuple[list[Path], list[Path]]:
        debs = self._debs(package for package in lock.packages if not self._image.leaves_out(package.name))
        wheels = fetch_wheels(self._platform, lock.wheels, self._cache / "wheels")
        if lock.compiled:
            wheels += sorted(self.runner.run(self._compile_step(lock, interpreter)).iterdir())
        return debs, wheels

    def _compile_step(self, lock: Lock, interpreter: Path) -> Step:
        built_by = [*(one.sha256 for one in lock.build_packages), interpreter.name]
        inputs = [built_by, [one.model_dump() for one in lock.compiled], lock.epoch]

        def make(out: Path) -> None:
            debs = self._debs(lock.build_packages)
            files = compiled_wheels.fetch_sources(lock.compiled, self._cache / "wheels")
            sources = zip(lock.compiled, files, strict=True)
            compiled_wheels.compile_wheels(self._platform, sources, debs, interpreter, out, lock.epoch)

        return Step("compiled", key_of([*inputs, self._platform.architecture], compiled_wheels, targets), make)

    def _kernel_step(self, lock: Lock) -> Step:
        wanted = self._platform.kernel

        def make(out: Path) -> None:
            (package,) = self._debs([lock.kernel])
            if isinstance(wanted, PackagedKernel):
                packaged_kernel.unpack_kernel(package, wanted, out)
            else:
                kernel.build_kernel(wanted, package, out, self._cache)

        return Step("kernel", kernel_key(self._platform, lock), make)

    def _overlays_step(self, kernel_folder: Path) -> Step:
        names = self._platform.overlays
        trees = [Path(tree).name for tree in self._platform.kernel.device_trees]

        def make(out: Path) -> None:
            overlays.write_trees(kernel_folder, trees, names, out)

        inputs = [kernel_folder.name, [overlays.overlay_sha256(name) for name in names], trees]
        return Step("overlays", key_of(inputs, overlays), make)

    def _initrd_step(self, lock: Lock, kernel_folder: Path, base: Path) -> Step:
        inputs = [kernel_folder.name, base.name, lock.epoch, file_sha256(packaged_kernel.INIT)]

        def make(out: Path) -> None:
            packaged_kernel.write_initrd(kernel_folder, base, out, lock.epoch)

        return Step("initrd", key_of(inputs, packaged_kernel), make)

    def _interpreter_step(self, lock: Lock) -> Step:
        packages = of_this_machine(lock.interpreter)

        def make(out: Path) -> None:
            tree.unpack_packages(self._debs(packages), out)

        return Step("interpreter", key_of([one.sha256 for one in packages], tree), make)

    def _base_step(self, lock: Lock, debs: list[Path], wheels: list[Path], interpreter: Path) -> Step:
        image = self._image
        hashes = [[deb.stem for deb in debs], [file_sha256(wheel) for wheel in wheels]]
        inputs = [*hashes, image.prune, image.keep, image.sourceless, lock.epoch, interpreter.name]

        def make(out: Path) -> None:
            out.mkdir(parents=True)
            tree.unpack_packages(debs, out)
            tree.unpack_wheels(wheels, out)
            tree.settle(out)
            pruning.prune_tree(out, image.prune, image.keep)
            slimming.strip_libraries(out / tree.SITE)
            slimming.drop_languages(out)
            slimming.drop_spare_libraries(out)
            folders = [f"usr/lib/python{self._platform.python}", tree.SITE]
            skip = f"/{bytecode.OPENCV}/"
            bytecode.compile_tree(interpreter, out, folders, sourceless=image.sourceless, skip=skip)
            bytecode.compile_tree(interpreter, out, [f"{tree.SITE}/{bytecode.OPENCV}"], sourceless=False)
            missing = tree.missing_libraries(out)
            if missing:
                told = "; ".join(f"{name} for {', '.join(sorted(users)[:3])}" for name, users in missing.items())
                raise BuildError(f"pruning removed required shared libraries: {told}")

        return Step("base", key_of(inputs, tree, pruning, slimming, bytecode), make)

    def _root_step(self, lock: Lock, base: Path, interpreter: Path) -> Step:
        layers = layers_of(self._image)
        files = [(str(path), path) for layer in layers for path in layer.rglob("*") if not path.is_dir()]
        named = [(name.rpartition("/rootfs/")[2], path) for name, path in files if "__pycache__" not in name]
        own = list(project.project_files()) if self._image.project else []
        inputs = [base.name, files_sha256(named), files_sha256(own), self._image.services, self._image.sourceless]

        def make(out: Path) -> None:
            shutil.copytree(base, out, symlinks=True)
            self._lay_over(out, lock, layers, interpreter)

        return Step("root", key_of([*inputs, lock.epoch], tree, bytecode, project), make)

    def _lay_over(self, root: Path, lock: Lock, layers: list[Path], interpreter: Path) -> None:
        for name in _FOLDERS:
            (root / name).mkdir(parents=True, exist_ok=True)
        inittab = (layers[0] / "etc/inittab").read_text()
        for layer in layers:
            if not layer.is_dir():
                raise BuildError(f"there is no folder {layer.name} in {layer.parent}")
            tree.overlay(layer, root)
            inittab += (layer / "inittab").read_text() if (layer / "inittab").is_file() else ""
            (root / "inittab").unlink(missing_ok=True)
        (root / "etc/inittab").write_text(inittab)
        (root / "etc/resolv.conf").symlink_to("/run/resolv.conf")
        if self._image.project:
            project.install_project(root)
            bytecode.compile_tree(interpreter, root, [_OWN], sourceless=self._image.sourceless, skip="/_bundled/")
            bytecode.compile_tree(interpreter, root, [f"{_OWN}/_bundled"], sourceless=False)
        bytecode.compile_tree(interpreter, root, ["usr/lib/evbotos"], sourceless=True)
        about = root / "etc/evbotos"
        about.mkdir(parents=True, exist_ok=True)
        (about / "platform").write_text(f"{self._platform.name}\n")
        (about / "epoch").write_text(f"{lock.epoch}\n")
        (about / "manifest.json").write_text(json.dumps(manifest_of(lock, self._image), indent=1) + "\n")
        tree.normalise(root)
        (root / "tmp").chmod(0o1777)

    def _squash_step(self, lock: Lock, root: Path) -> Step:
        options = squash.options_of(self._image.compression, self._platform.architecture)

        def make(out: Path) -> None:
            squash.squash(root, out, options, lock.epoch)

        return Step("squash", key_of([root.name, options, lock.epoch], squash), make)

    def _verity_step(self, squashed: Path) -> Step:
        def make(out: Path) -> None:
            verity.append_hashes(squashed, out)

        return Step("verity", key_of(squashed.name, verity), make)

    def _board_step(self, lock: Lock, kernel_folder: Path) -> Step:
        platform = self._platform
        wanted = [package for package in lock.build_packages if package.name in platform.boot_files]
        trees = [Path(name).name for name in platform.kernel.device_trees]
        overlaid = [(name, overlays.overlay_sha256(name)) for name in platform.firmware_overlays]
        files = [platform.boot_files, platform.boot_texts, trees, overlaid]
        inputs = [kernel_folder.name, [one.sha256 for one in wanted], *files]

        def make(out: Path) -> None:
            u_boot.write_board_files(platform, self._boot_packages(wanted), kernel_folder, out)

        return Step("board", key_of(inputs, u_boot, overlays), make)

    def _grub_step(self, lock: Lock) -> Step:
        wanted = [package for package in lock.build_packages if package.name in self._platform.disk_packages]

        def make(out: Path) -> None:
            grub.write_images(self._boot_packages(wanted), out)

        return Step("grub", key_of([one.sha256 for one in wanted], grub), make)

    def _emulator_step(self, lock: Lock, kernel_folder: Path) -> Step:
        """Return the step that prepares QEMU's substitutes for a board's ROM and device tree."""
        emulator, loader = self._platform.emulator, self._platform.emulator_loader
        wanted = [package for package in lock.build_packages if loader and package.name == loader.package]
        told = emulator and emulator.model_dump(mode="json")

        def make(out: Path) -> None:
            out.mkdir()
            if loader is not None:
                (package,) = self._boot_packages(wanted).values()
                (content,) = u_boot.read_files(package, loader.package, [loader.file])
                (out / qemu.LOADER).write_bytes(qemu.loader_of(content, loader))
            if emulator is not None and emulator.device_tree is not None:
                qemu.write_device_tree(kernel_folder / emulator.device_tree, emulator.lacks, out / qemu.DEVICE_TREE)

        return Step("emulator", key_of([kernel_folder.name, [one.sha256 for one in wanted], told], qemu, u_boot), make)

    def _boot_packages(self, wanted: list[LockedPackage]) -> dict[str, Path]:
        return {package.name: deb for package, deb in zip(wanted, self._debs(wanted), strict=True)}

    def _disk_step(
        self, lock: Lock, verified: Path, kernel_folder: Path, board: Path | None, images: Path | None
    ) -> Step:
        gathered, left_out = gather_robot_files(self._local)
        if left_out:
            self._warn(f"left out of the robot's files, because they belong to others: {', '.join(left_out)}")
        layout, platform = self._image.layout, self._platform
        parts = [part and part.name for part in (verified, kernel_folder, board, images)]
        inputs = [*parts, layout.model_dump(), platform.loader, disk.kernel_line(platform), lock.epoch]
        contents = [(name, hashed) for name, (hashed, _) in sorted(gathered.items())]

        def make(out: Path) -> None:
            boot_files = self._cache / ".part-robot"
            boot_files.mkdir()
            for name, (_, content) in gathered.items():
                (boot_files / name).parent.mkdir(parents=True, exist_ok=True)
                (boot_files / name).write_bytes(content)
            kernel_file = kernel_folder / platform.kernel.file
            identity = verity.read_verity(verified)
            what = disk.Contents(
                platform, verified / verity.ROOT, identity, kernel_file, board, images, boot_files, lock.epoch
            )
            out.mkdir()
            try:
                disk.write_disk(out / "disk.img", layout, what)
                if images is not None:
                    disk.write_boot_drive(out / "boot.img", layout, what)
            finally:
                shutil.rmtree(boot_files)

        return Step("disk", key_of([inputs, contents], disk, grub, slots, u_boot, verity), make)

    def _bill_step(self, lock: Lock, debs: list[Path], wheels: list[Path]) -> Step:
        platform, image = self._platform, self._image
        loaders = [package for package in lock.build_packages if package.name in platform.disk_packages]
        names = [package.name for package in lock.packages if not image.leaves_out(package.name)]
        inputs = [lock.model_dump(mode="json"), names, platform.model_dump(mode="json")]

        def make(out: Path) -> None:
            files = {**dict(zip(names, debs, strict=True)), **self._boot_packages(loaders)}
            origins = licences.with_shared({name: licences.debian_origin(deb) for name, deb in files.items()})
            origins |= {licences.wheel_name(wheel): licences.wheel_origin(wheel) for wheel in wheels}
            out.write_text(sbom.bill_of_materials(lock, image, platform, origins))

        return Step("bill", key_of(inputs, sbom, licences), make)

    def _sizes_step(self, root: Path) -> Step:
        def make(out: Path) -> None:
            out.write_text(json.dumps(sizes.sizes_of(root), indent=1) + "\n")

        return Step("sizes", key_of(root.name, sizes), make)
