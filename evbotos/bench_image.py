"""The benchmark inside an image in QEMU, started over SSH with a temporary key."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from eal_actors.kernel.clock import REAL_TIME
from evbotos.bench import Benchmark, Engine, run_by, script_of
from evbotos.disk import START
from evbotos.errors import BuildError
from evbotos.hosttools import tool
from evbotos.model import Platform
from evbotos.qemu import Machine, running
from evbotos.shell import run

_UP_S: Final = 180.0
_PROGRAMS: Final = {"octave": "octave-cli --norc --quiet --no-history", "numpy": "python3"}


def run_in_image(
    platform: Platform, folder: Path, engine: Engine, n: int, memory_mb: int, timeout_s: float
) -> Benchmark:
    """Boot a built image and run the benchmark in it.

    Args:
        platform: a platform with an emulator.
        folder: the output folder of the build.
        engine: the numeric engine.
        n: rows and columns of the matrix.
        memory_mb: RAM of the machine.
        timeout_s: real seconds for the benchmark itself.

    Raises:
        BuildError: the image does not start, or the benchmark fails.
    """
    with TemporaryDirectory(prefix="evbotos-bench-") as name:
        work = Path(name)
        disk = Path(shutil.copyfile(folder / "disk.img", work / "disk.img"))
        key = _new_key(work)
        _let_in(disk, key.with_suffix(".pub"))
        with running(platform, folder, disk, work / "console", memory_mb) as machine:
            ssh = _ssh(key, machine.ports["ssh"])
            _wait_for(ssh, machine)
            script = script_of(engine)
            there = f"/run/{script.name}"
            command = f"cat > {there} && {_PROGRAMS[engine]} {there} {n}"
            where = f"{platform.name} in QEMU, {memory_mb} MB"
            return run_by([*ssh, command], script.read_bytes(), n, where, timeout_s)


def _new_key(work: Path) -> Path:
    key = work / "key"
    run([tool("ssh-keygen"), "-q", "-t", "ed25519", "-N", "", "-C", "bench", "-f", key])
    return key


def _let_in(disk: Path, public: Path) -> None:
    """Write a key to the boot partition of a copy of the image."""
    place = f"{disk}@@{START}"
    listed = run([tool("mdir"), "-b", "-i", place, "::/"], env={"MTOOLS_SKIP_CHECK": "1"})
    if "::/robot" not in listed:
        run([tool("mmd"), "-i", place, "::/robot"], env={"MTOOLS_SKIP_CHECK": "1"})
    run([tool("mcopy"), "-o", "-i", place, public, "::/robot/authorized_keys"], env={"MTOOLS_SKIP_CHECK": "1"})


def _ssh(key: Path, port: int) -> list[str]:
    quiet = ["StrictHostKeyChecking=no", f"UserKnownHostsFile={os.devnull}", "LogLevel=ERROR", "BatchMode=yes"]
    options = [word for option in [*quiet, "ConnectTimeout=5", "IdentitiesOnly=yes"] for word in ("-o", option)]
    return [tool("ssh"), *options, "-i", str(key), "-p", str(port), "root@127.0.0.1"]


def _wait_for(ssh: list[str], machine: Machine) -> None:
    end_s = REAL_TIME.now() + _UP_S
    while REAL_TIME.now() < end_s and machine.is_running():
        done = subprocess.run([*ssh, "true"], capture_output=True, timeout=60, check=False)  # noqa: S603
        if done.returncode == 0:
            return
        REAL_TIME.sleep(0.5)
    said = machine.console.read_text(errors="replace").splitlines()[-8:]
    raise BuildError("\n".join(["the image refuses the login; last lines of its console:", *said]))
