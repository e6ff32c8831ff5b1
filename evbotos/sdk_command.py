"""`evbotos sdk`: the archive for compiling plugins."""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from eal_actors.kernel.clock import REAL_TIME
from evbotos.build import OUTPUT, cache_folder
from evbotos.definitions import load_definitions
from evbotos.hashing import file_sha256
from evbotos.hosttools import require
from evbotos.lock import require_lock
from evbotos.options import JsonOption, LocalOption, OutputOption, PlatformArgument
from evbotos.packages import apt_for
from evbotos.sdk import (
    ENVIRONMENT,
    IMAGE,
    environment_text,
    make_sysroot,
    missing_compiler,
    python_of,
    readme_text,
    write_archive,
)
from evbotos.steps import owned
from evbotos.terminal import console, write_json


def sdk(
    platform: PlatformArgument,
    local: LocalOption = None,
    output: OutputOption = OUTPUT,
    as_json: JsonOption = False,
) -> None:
    """Build the SDK of a platform: a sysroot and a script that sets CC and related variables."""
    found = load_definitions(local)
    board, image = found.platform(platform), found.image(IMAGE)
    lock = require_lock(found.lock_path(board, image), board, image)
    require(["dpkg-deb", "apt-get"])
    progress, start_s = console(error=True), REAL_TIME.now()
    cache = cache_folder(found.local)
    name = f"evbotos-sdk-{board.name}"
    output.mkdir(parents=True, exist_ok=True)
    with owned(cache), TemporaryDirectory(dir=cache, prefix=".part-sdk-") as work:
        folder = Path(work) / name
        (folder / "sysroot").mkdir(parents=True)
        apt = apt_for(board, board.architecture, found.local.mirror, cache, progress.print)
        progress.print("packages")
        debs = apt.fetch((one for one in lock.packages if not image.leaves_out(one.name)), cache / "debs")
        progress.print("sysroot")
        make_sysroot(debs, folder / "sysroot")
        (folder / ENVIRONMENT).write_text(environment_text(board, python_of(folder / "sysroot")))
        (folder / "README").write_text(readme_text(board, lock))
        progress.print("archive")
        archive = output / f"{name}.tar.xz"
        write_archive(folder, name, archive, lock.epoch)
        size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
        shutil.rmtree(folder)
    told = {
        "archive": str(archive),
        "bytes": archive.stat().st_size,
        "unpacked_bytes": size,
        "sha256": file_sha256(archive),
    }
    if as_json:
        write_json(told)
        return
    mb, unpacked = archive.stat().st_size / 1e6, size / 1e6
    console().print(
        f"{archive}: {mb:.1f} MB ({unpacked:.1f} MB unpacked), made in {REAL_TIME.now() - start_s:.1f} s",
        soft_wrap=True,
    )
    package = missing_compiler(board)
    if package is not None:
        console().print(f"The compiler is not installed: apt-get install {package}")
