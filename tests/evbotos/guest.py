"""A guest of QEMU that runs a command of this machine under Debian's kernel, for devices that the machine's own lacks.

The guest sees this machine's files, read only, so it has the same Python and the same source. Its `/run` is writable
memory. No privileges are needed.
"""

from __future__ import annotations

import re
import shlex
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from evbotos.hosttools import tool
from evbotos.model import PackagedKernel
from evbotos.packaged_kernel import unpack_kernel, write_initrd
from evbotos.shell import run

KERNEL: Final = "linux-image-amd64"
INIT: Final = Path(__file__).with_name("guest-init")
_FILE_SYSTEM: Final = ("virtio_pci", "9pnet_virtio", "9p")
_MEMORY_MB: Final = 1500
_KERNEL_LINE: Final = "console=ttyS0 quiet panic=-1 no_timer_check"
"""The check of the timer fails in a guest on a loaded machine."""


class Outcome(NamedTuple):
    """The end of a command in a guest.

    Attributes:
        exit_code: of the command; None if it did not end.
        output: of the console.
    """

    exit_code: int | None
    output: str


class Guest:
    """Debian's kernel, and a RAM disk that loads modules.

    Args:
        folder: for its files.
        modules: to load, such as `uinput`.
    """

    def __init__(self, folder: Path, *modules: str) -> None:
        self._folder = folder
        self._kernel, self._initrd = debian_kernel(folder, KERNEL, (*_FILE_SYSTEM, *modules), INIT)

    def run(self, command: Sequence[str | Path], cwd: Path, timeout_s: float) -> Outcome:
        """Run a command as root. Thread: blocks the caller.

        Raises:
            TimeoutExpired: the guest did not end in time.
        """
        shared = self._folder / "shared"
        shared.mkdir(exist_ok=True)
        (shared / "command").write_text(f"cd {shlex.quote(str(cwd))}\nexec {shlex.join(map(str, command))}\n")
        arguments: list[str | Path] = ["-accel", "tcg,tb-size=256", "-cpu", "max", "-smp", "2", "-m", str(_MEMORY_MB)]
        arguments += ["-nodefaults", "-no-user-config", "-display", "none", "-no-reboot", "-serial", "stdio"]
        arguments += [
            "-kernel",
            self._kernel,
            "-initrd",
            self._initrd,
            "-append",
            _KERNEL_LINE,
        ]
        for path, tag, access in (("/", "host", "on"), (shared, "shared", "off")):
            sharing = f"local,path={path},mount_tag={tag},security_model=none,readonly={access},multidevs=remap"
            arguments += ["-virtfs", sharing]
        ended = subprocess.run(
            [tool("qemu-system-x86_64"), *arguments],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=timeout_s,
        )
        said = re.search(r"^guest: exit code (\d+)", ended.stdout, re.MULTILINE)
        return Outcome(None if said is None else int(said[1]), ended.stdout + ended.stderr)


def debian_kernel(folder: Path, package: str, modules: Sequence[str], init: Path) -> tuple[Path, Path]:
    """Return a kernel of Debian and an initial RAM disk that starts with a script.

    Args:
        folder: for its files.
        package: a metapackage, such as `linux-image-amd64`.
        modules: what the script may load, with what these depend on.
        init: the script.
    """
    kernel, tree, initrd = folder / "kernel", folder / "busybox", folder / "initrd"
    wanted = PackagedKernel(package=package, modules=tuple(modules))
    unpack_kernel(_download(folder, _depended(package)), wanted, kernel)
    run([tool("dpkg-deb"), "-x", _download(folder, "busybox-static"), tree])
    write_initrd(kernel, tree, initrd, 0, init)
    return kernel / wanted.file, initrd


def _depended(package: str) -> str:
    """Return the package that a metapackage depends on."""
    said = run(["apt-cache", "depends", package])
    return str(re.findall(r"Depends: (linux-image-\S+)", said)[0])


def _download(folder: Path, package: str) -> Path:
    """Download a package of Debian; return its file."""
    run([tool("apt-get"), "download", package], cwd=folder)
    return next(folder.glob(f"{package}_*.deb"))
