"""`evbotos run`: a built image in QEMU, with a fleet file that fits it."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from math import ceil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Final

import typer
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat
from rich.console import Console

from eal_actors.kernel.clock import REAL_TIME
from evbotos.build import OUTPUT
from evbotos.definitions import load_definitions
from evbotos.errors import BuildError
from evbotos.hosttools import require
from evbotos.identity import has_fleet, put_identity
from evbotos.model import Emulator, Image, Local
from evbotos.options import ImageArgument, LocalOption, OutputOption, PlatformArgument, built_folder
from evbotos.provision_command import provision_fleet
from evbotos.qemu import Machine, running
from evbotos.robot_files import access_files
from evbotos.shell import run

_TRIAL: Final = """\
# A robot in QEMU, for trying an image: written by `evbotos run`, with keys of its own beside it.
version: 1
name: trial
defaults: {timeout_s: 60}  # an emulator is slow
robots:
  evbot:
    plugins: {sim: {model: evbot3}}
    address: tls/127.0.0.1:${EVBOT_PORT:-50000}
    listen: tls/0.0.0.0:50000
"""


def run_image(
    platform: PlatformArgument,
    image: ImageArgument = "robot",
    local: LocalOption = None,
    output: OutputOption = OUTPUT,
    memory_mb: Annotated[
        int | None, typer.Option("--memory-mb", min=16, help="RAM.", show_default="what board and image need")
    ] = None,
    keep: Annotated[bool, typer.Option("--keep", help="Keep changes to the disk.")] = False,
    identity: Annotated[
        Path | None,
        typer.Option("--identity", show_default="one for trying", help="A robot's identity of `evbotos provision`."),
    ] = None,
) -> None:
    """Run a built image in QEMU until Ctrl-C, with its ports forwarded to this machine.

    A temporary copy of an image without a fleet gets keys for trying, and a fleet file that fits is printed.
    """
    found = load_definitions(local)
    board, what = found.chosen(platform, image)
    if board.emulator is None:
        raise BuildError(f"QEMU cannot emulate {board.name}")
    require([board.emulator.program, "mcopy"])
    folder = built_folder(output, platform, image)
    console_log = folder / "console.log"
    console_log.write_bytes(b"")
    out = Console(highlight=False, markup=False, emoji=False)
    with TemporaryDirectory(prefix="evbotos-disk-") as work:
        disk, trial = folder / "disk.img", None
        if not keep:
            disk = Path(shutil.copyfile(disk, Path(work) / "disk.img"))
            if identity is None and "robot" in what.services and not has_fleet(disk):
                trial = folder / "trial"
                identity = trial_identity(trial, found.local)
        if identity is not None:
            put_identity(identity, disk)
        with running(board, folder, disk, console_log, memory_mb or memory_for(board.emulator, what)) as machine:
            _show_ports(out, machine, trial)
            _follow(out, machine)


def memory_for(emulator: Emulator, image: Image) -> int:
    """Return the RAM of an emulated machine in MB: the board's, or more where the image needs more."""
    return max(emulator.memory_mb, ceil(image.budget_mb.memory or 0))


def trial_identity(folder: Path, local: Local) -> Path:
    """Return the identity of a robot in QEMU; its keys are made once.

    Args:
        folder: the folder of its fleet file, keys and SSH key.
        local: who else may log in, and whose updates are accepted.

    Raises:
        BuildError: the keys cannot be made.
    """
    fleet, ssh_key = folder / "fleet.yaml", folder / "ssh"
    folder.mkdir(mode=0o700, exist_ok=True)
    if not (folder / "keys/ca.pem").is_file():
        fleet.write_text(_TRIAL)
        run([sys.executable, "-P", "-m", "eal_actors", "keys", "init", "--write", "--force", "--fleet", fleet])
    if not ssh_key.is_file():
        key = Ed25519PrivateKey.generate()
        with os.fdopen(os.open(ssh_key, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(key.private_bytes(Encoding.PEM, PrivateFormat.OpenSSH, NoEncryption()))
        public = key.public_key().public_bytes(Encoding.OpenSSH, PublicFormat.OpenSSH)
        (folder / "ssh.pub").write_bytes(public + b"\n")
    keys = (*local.ssh_keys, (folder / "ssh.pub").read_text())
    access = access_files(local.model_copy(update={"ssh_keys": keys}))
    return provision_fleet(fleet, None, access, folder)["evbot"]


def _show_ports(out: Console, machine: Machine, trial: Path | None) -> None:
    key, fleet = "", "FLEET"
    if trial is not None:
        key = f" -i {shlex.quote(str(trial / 'ssh'))} -o UserKnownHostsFile=/dev/null"
        fleet = shlex.quote(str(trial / "fleet.yaml"))
    ports = machine.ports
    out.print(f"SSH: ssh -p {ports['ssh']}{key} root@127.0.0.1", soft_wrap=True)
    out.print(f"EAL: EVBOT_PORT={ports['eal']} eal run square --fleet {fleet}", soft_wrap=True)
    if trial is None:
        out.print("FLEET: the controller's copy of the robot's fleet file, with the address above.", soft_wrap=True)
    out.print("Ctrl-C ends it.")


def _follow(out: Console, machine: Machine) -> None:
    """Print the console until QEMU ends."""
    with machine.console.open(errors="replace") as said:
        while machine.is_running():
            out.print(said.read(), end="", soft_wrap=True)
            REAL_TIME.sleep(0.2)
        out.print(said.read(), end="", soft_wrap=True)
