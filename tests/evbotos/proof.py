"""Shared by tests of booted images: a robot image with its own keys, and operations on its machine."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from eal_actors import Fleet
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import EALError
from eal_actors.kernel.log import get_logger
from evbotos import slots, squash
from evbotos.build import Build
from evbotos.definitions import load_definitions
from evbotos.hosttools import find_tool, needed_for
from evbotos.lock import lock_path
from evbotos.model import Image, Local, PackagedKernel, Platform
from evbotos.outputs import Built
from evbotos.qemu import Machine, running

ROBOT = "evbot"
FLEET = """version: 1
name: proof
defaults: {timeout_s: 120}  # an emulator on a busy machine is slow
robots:
  evbot:
    plugins: {sim: {model: evbot3}}
    address: tls/127.0.0.1:${EVBOT_PORT:-50000}
    listen: tls/0.0.0.0:50000
network:
  lease_s: 60
  dead_man_s: 60
  security: {keys: keys, controller: controller, roles: {controllers: [controller]}}
"""
DEBIAN_KERNEL = PackagedKernel(
    package="linux-image-cloud-amd64",
    modules=(
        "virtio_pci",
        "virtio_blk",
        "virtio_net",
        "virtio_rng",
        "squashfs",
        "overlay",
        "vfat",
        "nls_cp437",
        "nls_ascii",
    ),
)
"""A kernel that needs no compilation."""
LONGEST_BOOT_S = 400.0
"""The limit of a boot in processor time; a loaded machine takes several times as long in real time."""
BUSY = 4.0
"""The maximum ratio of real time to processor time."""
SERVES = "serves Base"
_LOG = get_logger()


@dataclass(frozen=True)
class Proof:
    """The image under test.

    Attributes:
        platform: the board.
        image: what was built for it.
        built: where it is.
        fleet: the controller's fleet file, with its keys.
        robot_files: folder with the robot's fleet file and keys.
        ssh_key: private key that may log in.
        update_key: private key whose updates the robot takes.
    """

    platform: Platform
    image: Image
    built: Built
    fleet: Path
    robot_files: Path
    ssh_key: Path
    update_key: Path


def run(*argv: str | Path, **env: str) -> str:
    done = subprocess.run(
        [str(part) for part in argv], env={**os.environ, **env}, capture_output=True, timeout=600, check=False
    )
    assert done.returncode == 0, f"{argv}: {done.stdout.decode()}{done.stderr.decode()}"
    return done.stdout.decode()


def eal(*words: str | Path, **env: str) -> str:
    return run(sys.executable, "-m", "eal_actors", *words, **env)


def require_tools(platform: Platform) -> None:
    """Skip the test if a program is missing that builds an image of a platform, starts it or logs into it."""
    assert platform.emulator is not None
    needed = (*needed_for(platform), platform.emulator.program, "ssh")
    missing = [name for name in needed if find_tool(name) is None]
    if missing:
        pytest.skip(f"not installed: {', '.join(missing)} (make evbotos-setup)")


def give_keys(folder: Path, text: str = FLEET) -> tuple[Path, Local]:
    """Make a fleet and every key that a robot needs; returns the controller's fleet file and the builder's settings."""
    fleet = folder / "fleet.yaml"
    fleet.write_text(text)
    eal("keys", "init", "--fleet", fleet)
    eal("keys", "robot", ROBOT, "--fleet", fleet)
    eal("keys", "controller", "controller", "--fleet", fleet)
    robot = folder / "robot"
    (robot / "keys").mkdir(parents=True)
    for name in ("fleet.yaml", "keys/ca.pem", f"keys/{ROBOT}.pem", f"keys/{ROBOT}.key"):
        shutil.copy(folder / name, robot / name)
    return fleet, give_access(folder).model_copy(update={"robot": str(robot)})


def give_access(folder: Path) -> Local:
    """Make a key that may log in, `ssh`, and one that signs updates, `update.pem`; return settings that permit both."""
    run("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", folder / "ssh")
    key = Ed25519PrivateKey.generate()
    (folder / "update.pem").write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    public = key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    (folder / "update.pub.pem").write_bytes(public)
    ssh_key = (folder / "ssh.pub").read_text().strip()
    return Local(version=1, ssh_keys=(ssh_key,), update_key=str(folder / "update.pub.pem"))


def built_proof(
    platform: Platform,
    image: Image,
    folder: Path,
    *,
    fleet_text: str = FLEET,
    current_packages: bool = False,
    settings: Mapping[str, object] | None = None,
) -> Proof:
    """Build an image with keys of its own, and log its size; skip the test if a program is missing.

    Args:
        platform: the board.
        image: the image definition.
        folder: folder of everything that is made.
        fleet_text: the fleet file.
        current_packages: take what the archive offers now; the default is what the image's lock file names.
        settings: changes of the builder's settings.
    """
    require_tools(platform)
    fleet, local = give_keys(folder, fleet_text)
    local = local.model_copy(update=settings)
    lock_file = (
        lock_path(platform, image, folder) if current_packages else load_definitions().lock_path(platform, image)
    )
    built = Build(platform, image, local, lock_file, _LOG.info).run(folder / "out", update_lock=current_packages)
    _LOG.warning(f"{platform.name} {image.name}: root and kernel {built.report['root_with_kernel_mb']} MB")
    return Proof(platform, image, built, fleet, folder / "robot", folder / "ssh", folder / "update.pem")


@contextmanager
def compressed_quickly() -> Iterator[None]:
    """Compress roots at a low level: it changes only the size, and takes a third of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(squash._OPTIONS, "zstd", ("-comp", "zstd", "-Xcompression-level", "3", "-b", "128K"))
        yield


@contextmanager
def started(
    proof: Proof,
    disk: Path,
    *,
    memory_mb: int | None = None,
    network: str | None = None,
    boot_drive: Path | None = None,
) -> Iterator[Machine]:
    """Start a machine with a disk, which it writes to."""
    console = disk.with_suffix(".log")
    console.write_bytes(b"")
    with running(proof.platform, proof.built.folder, disk, console, memory_mb, network, boot_drive) as machine:
        yield machine


def parse_choice(block: bytes) -> dict[str, str]:
    """Return what boot loader and system have told each other: U-Boot leaves out what is empty, and ends with zeros."""
    assert len(block) == slots.SIZE
    lines = block.decode("ascii").splitlines()
    return dict(line.split("=", 1) for line in lines if "=" in line and not line.startswith("#"))


def said(machine: Machine) -> str:
    return machine.console.read_text(errors="replace")


def wait_until(machine: Machine, what: str, is_so: Callable[[], bool], longest_s: float = LONGEST_BOOT_S) -> None:
    """Wait for a condition; fails with what the console said.

    QEMU's processor time counts, so that a busy machine makes nothing fail; where QEMU idles, real time counts.
    """
    end_s, computed_s = REAL_TIME.now() + BUSY * longest_s, machine.computed_s() + longest_s
    while not is_so():
        if not machine.is_running() or machine.computed_s() > computed_s or REAL_TIME.now() > end_s:
            pytest.fail(f"{what}: not within {longest_s:g} s\n{said(machine)[-4000:]}")
        REAL_TIME.sleep(0.3)


def wait_for_words(machine: Machine, words: str, times: int = 1) -> None:
    """Wait until the console has said some words so many times."""
    wait_until(machine, f"the console says {words!r}, {times} times", lambda: said(machine).count(words) >= times)


def first_answer_s(proof: Proof, machine: Machine, monkeypatch: pytest.MonkeyPatch) -> float:
    """Return how long it took until a call was answered."""
    start_s = REAL_TIME.now()
    monkeypatch.setenv("EVBOT_PORT", str(machine.ports["eal"]))
    with Fleet.load(proof.fleet) as fleet:

        def is_answered() -> bool:
            try:
                fleet[ROBOT]["Base"].get_status(timeout_s=5).get()
            except EALError:
                return False
            return True

        wait_until(machine, "the first answered call", is_answered)
    return REAL_TIME.now() - start_s


def ssh_words(proof: Proof, machine: Machine) -> list[str]:
    """Return the command that logs into the image, by the key that may."""
    options = ("StrictHostKeyChecking=no", "UserKnownHostsFile=/dev/null", "ConnectTimeout=60", "BatchMode=yes")
    words = [word for option in options for word in ("-o", option)]
    return ["ssh", "-q", *words, "-i", str(proof.ssh_key), "-p", str(machine.ports["ssh"]), "root@127.0.0.1"]


def ssh(proof: Proof, machine: Machine, command: str, data: bytes = b"") -> subprocess.CompletedProcess[str]:
    """Run a command in the image."""
    done = subprocess.run(
        [*ssh_words(proof, machine), command], input=data, capture_output=True, timeout=600, check=False
    )
    return subprocess.CompletedProcess(done.args, done.returncode, done.stdout.decode(), done.stderr.decode())


def answer(proof: Proof, machine: Machine, command: str, data: bytes = b"") -> str:
    """Run a command in the image, which must succeed."""
    done = ssh(proof, machine, command, data)
    assert done.returncode == 0, f"{command}: {done.returncode}: {done.stdout}{done.stderr}"
    return done.stdout
