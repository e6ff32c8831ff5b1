"""The script in the real U-Boot of QEMU's ARM board: which slots it starts, by the slot state and the hash files."""

from __future__ import annotations

import os
import random
import subprocess
from pathlib import Path

import pytest

from evbotos import slots, u_boot
from evbotos.apt_sources import sources_for
from evbotos.definitions import load_definitions
from evbotos.disk import DISK_ID, MIB, kernel_line
from evbotos.errors import BuildError
from evbotos.hosttools import find_tool
from evbotos.lock import lock_path, read_lock
from evbotos.packages import Apt
from tests.evbotos.proof import parse_choice
from tests.evbotos.test_u_boot import VERITY, disk_of

SEEDS = 30
SHORT = 4
LOADS = "if load ${part} ${ramdisk_addr_r} vmlinuz"

pytestmark = [pytest.mark.evbotos, pytest.mark.timeout(3600)]


@pytest.fixture(scope="module")
def loader(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """U-Boot of the package that the lock file pins."""
    if find_tool("qemu-system-aarch64") is None or find_tool("mkimage") is None:
        pytest.skip("not installed: qemu-system-aarch64, mkimage (make evbotos-setup)")
    found, folder = load_definitions(), tmp_path_factory.mktemp("u-boot")
    platform = found.platform("qemu-arm64")
    lock = read_lock(lock_path(platform, found.image("robot")))
    assert lock is not None
    assert platform.emulator_loader is not None
    locked = [package for package in lock.build_packages if package.name == platform.emulator_loader.package]
    apt = Apt(folder / "apt", platform.architecture, sources_for(platform.suite, None), pytest.fail)
    try:
        (package,) = apt.fetch(locked, folder / "debs")
    except BuildError as error:
        pytest.skip(f"the package cannot be had here: {error}")
    (content,) = u_boot.read_files(package, package.name, [platform.emulator_loader.file])
    (folder / "u-boot.bin").write_bytes(content)
    return folder / "u-boot.bin"


def started_slots(loader: Path, folder: Path, state: dict[str, str], verified: str) -> tuple[list[str], dict[str, str]]:
    """Return the slots whose kernel U-Boot loads, in order, and the slot state that it leaves.

    The kernels are no kernels, so U-Boot goes on to the other slot after each.
    """
    platform = load_definitions().platform("qemu-arm64")
    disk = disk_of(platform, folder)
    text = u_boot.script(platform, kernel_line(platform), DISK_ID)
    assert text.count(LOADS) == 1
    assert text.endswith("\nreset\n")
    text = text.replace(LOADS, f"printenv bootargs; {LOADS}").replace("\nreset\n", "\npoweroff\n")
    env = {**os.environ, "MTOOLS_SKIP_CHECK": "1"}
    files = {u_boot.SCRIPT: u_boot.compile_script(text, 0), slots.FILE: slots.state_block({**slots.FIRST, **state})}
    for slot in "ab":
        files[slots.hash_file(slot)] = slots.state_block(VERITY.hash_file() if slot in verified else {})
    for name, content in files.items():
        (folder / name).write_bytes(content)
        subprocess.run(["mcopy", "-o", "-i", f"{disk}@@{MIB}", folder / name, "::/"], check=True, env=env)
    machine = ["-machine", "virt", "-accel", "tcg", "-cpu", "cortex-a53", "-m", "256", "-nographic", "-net", "none"]
    drive = ["-drive", f"file={disk},format=raw,if=none,id=d", "-device", "virtio-blk-pci,drive=d", "-no-reboot"]
    argv = ["qemu-system-aarch64", *machine, "-bios", str(loader), *drive]
    done = subprocess.run(argv, stdin=subprocess.DEVNULL, capture_output=True, timeout=600, check=True)
    lines = [line.strip() for line in done.stdout.decode(errors="replace").splitlines()]
    started = [line.rpartition("=")[2] for line in lines if line.startswith("bootargs=")]
    for slot, line in zip(started, (line for line in lines if line.startswith("bootargs=")), strict=True):
        part = f"PARTUUID={DISK_ID}-{'02' if slot == 'a' else '03'}"
        table = f'dm-mod.create="root,,,ro,0 {VERITY.sectors} verity 1 {part} {part} {VERITY.table}"'
        assert f"root=/dev/dm-0 rootfstype=squashfs dm-mod.waitfor={part} {table} ro " in line
    left = subprocess.run(
        ["mtype", "-i", f"{disk}@@{MIB}", f"::/{slots.FILE}"], capture_output=True, check=True, env=env
    )
    return started, parse_choice(left.stdout)


@pytest.mark.parametrize(
    ("state", "verified", "started", "left"),
    [
        ({}, "a", ["a"], {"good": "a", "starts": "x"}),
        ({"try": "b"}, "ab", ["b", "a"], {"good": "a"}),
        ({"try": "b"}, "a", ["a"], {"good": "a"}),
        ({"starts": "xxx", "floor": "1.2.3.4"}, "a", ["a"], {"good": "a", "starts": "x", "floor": "1.2.3.4"}),
        ({"starts": "xxx"}, "ab", ["b", "a"], {"good": "a", "starts": "x"}),
        ({"good": "b"}, "ab", ["b", "a"], {"good": "b", "starts": "x"}),
    ],
)
def test_the_slots_that_start(
    loader: Path, tmp_path: Path, state: dict[str, str], verified: str, started: list[str], left: dict[str, str]
) -> None:
    assert started_slots(loader, tmp_path, state, verified) == (started, left)


@pytest.mark.parametrize(
    "seed", [seed if seed < SHORT else pytest.param(seed, marks=pytest.mark.slow) for seed in range(SEEDS)]
)
def test_a_slot_without_a_hash_never_starts(loader: Path, tmp_path: Path, seed: int) -> None:
    generator = random.Random(seed)  # noqa: S311  # states
    good, verified = generator.choice("ab"), generator.choice(("a", "b", ""))
    state = {"good": good, "try": generator.choice(("", "a", "b")), "starts": "x" * generator.randrange(4)}
    started, _ = started_slots(loader, tmp_path, state, verified)
    assert started == list(verified), f"seed {seed}: {state}"
