"""Debian's kernels: unpacking, and an initial RAM disk that loads modules and finds the root."""

from __future__ import annotations

import gzip
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from evbotos.errors import BuildError
from evbotos.hosttools import tool
from evbotos.model import PackagedKernel
from evbotos.shell import run

INIT: Final = Path(__file__).parent / "kernel/initrd-init"
MODULES: Final = "modules"
PARAMETERS: Final = ".parameters"
"""The suffix of a file beside a module, with its parameters."""
_DEPENDS: Final = re.compile(rb"\0depends=([^\0]*)\0")
"""The field of a module that lists its dependencies."""
_FOLDER, _PROGRAM, _FILE, _CONSOLE = 0o040755, 0o100755, 0o100644, 0o020600
_CONSOLE_NUMBER: Final = (5, 1)


def unpack_kernel(package: Path, wanted: PackagedKernel, out: Path) -> None:
    """Unpack a packaged kernel into a folder: image, device trees, modules in load order.

    Raises:
        BuildError: the package lacks a kernel, module or device tree.
    """
    with TemporaryDirectory(dir=out.parent, prefix=".part-package-") as work:
        folder = Path(work)
        run([tool("dpkg-deb"), "-x", package, folder])
        images = list(folder.glob("boot/vmlinuz-*"))
        if len(images) != 1:
            raise BuildError(f"{wanted.package} does not contain a kernel")
        # A module built into the kernel has no file of its own.
        built_in = {Path(line).stem for line in _lines(folder, "modules.builtin")}
        files = {path.stem.replace("-", "_"): path for path in folder.rglob("*.ko")}
        (out / MODULES).mkdir(parents=True)
        shutil.copy(images[0], out / wanted.file)
        trees = {path.name: path for path in folder.rglob("*.dtb")}
        for name in wanted.device_trees:
            if name not in trees:
                raise BuildError(f"{wanted.package} has no device tree {name}")
            shutil.copy(trees[name], out / name)
        parameters = {_module(words): words.partition(" ")[2] for words in wanted.modules}
        for number, module in enumerate(in_order(tuple(parameters), files, built_in)):
            copy = Path(shutil.copyfile(module, out / MODULES / f"{number:03}-{module.name}"))
            if given := parameters.get(_module(module.stem)):
                copy.with_suffix(PARAMETERS).write_text(f"{given}\n")


def _module(words: str) -> str:
    """Return the name of a module as the kernel knows it; parameters may follow it."""
    return words.partition(" ")[0].replace("-", "_")


def _lines(folder: Path, name: str) -> Iterator[str]:
    for path in folder.rglob(name):
        yield from path.read_text().splitlines()


def in_order(names: tuple[str, ...], files: dict[str, Path], built_in: set[str]) -> list[Path]:
    """Return the files of modules and their dependencies in load order.

    Args:
        names: the module names.
        files: module files by name, with underscores.
        built_in: the names of built-in modules.

    Raises:
        BuildError: a module is missing.
    """
    there = {name.replace("-", "_") for name in built_in}
    found: dict[str, Path] = {}

    def add(name: str) -> None:
        name = name.replace("-", "_")
        if name in found or name in there:
            return
        if name not in files:
            raise BuildError(f"the kernel has no module {name}")
        match = _DEPENDS.search(files[name].read_bytes())
        for other in match[1].decode().split(",") if match and match[1] else ():
            add(other)
        found[name] = files[name]

    for name in names:
        add(name)
    return list(found.values())


def write_initrd(kernel: Path, root: Path, out: Path, epoch: int, init: Path = INIT) -> None:
    """Write the initial RAM disk: busybox with its libraries, the modules and the init script.

    Args:
        kernel: the output folder of `unpack_kernel`.
        root: a tree that contains busybox.
        out: the file.
        epoch: the date of every file.
        init: the script that the kernel runs.

    Raises:
        BuildError: busybox or one of its libraries is missing.
    """
    files = {"init": init, **{f"modules/{path.name}": path for path in sorted((kernel / MODULES).iterdir())}}
    merged = root / "usr/bin/busybox"
    files |= _with_libraries(root, merged if merged.exists() else root / "bin/busybox")
    folders = {"dev", "proc", "sys", "root"} | {
        parent.as_posix() for name in files for parent in Path(name).parents if parent != Path()
    }
    members = [_member(name, _FOLDER, b"", epoch) for name in sorted(folders)]
    members.append(_member("dev/console", _CONSOLE, b"", epoch, _CONSOLE_NUMBER))
    for name, path in files.items():
        mode = _FILE if name.startswith(f"{MODULES}/") else _PROGRAM
        members.append(_member(name, mode, path.read_bytes(), epoch))
    members.append(_member("TRAILER!!!", 0, b"", 0))
    out.write_bytes(gzip.compress(b"".join(members), mtime=0))


def _with_libraries(root: Path, program: Path) -> dict[str, Path]:
    """Return a program and its shared libraries by path in the image."""
    said = run([tool("readelf"), "-lW", program])
    interpreter = re.search(r"interpreter: /([^\]]+)\]", said)
    files = {"bin/busybox": program}
    if interpreter is not None:
        files[interpreter[1]] = root / interpreter[1]
    waiting = [program]
    while waiting:
        for name in re.findall(r"\(NEEDED\).*\[(.+)\]", run([tool("readelf"), "-dW", waiting.pop()])):
            if f"lib/{name}" in files or any(place.endswith(f"/{name}") for place in files):
                continue
            library = next(root.glob(f"usr/lib/**/{name}"), None)
            if library is None:
                raise BuildError(f"{name}, which busybox needs, is not in the image")
            files[f"lib/{name}"] = library
            waiting.append(library)
    return files


def _member(name: str, mode: int, content: bytes, date: int, device: tuple[int, int] = (0, 0)) -> bytes:
    """Return a file as a member of a `newc` cpio archive."""
    path = name.encode() + b"\0"
    inode, links = 0, 1
    fields = (inode, mode, 0, 0, links, date, len(content), 0, 0, *device, len(path), 0)
    head = b"070701" + b"".join(b"%08X" % field for field in fields)
    return _padded(head + path) + _padded(content)


def _padded(content: bytes) -> bytes:
    return content + bytes(-len(content) % 4)
