"""The images without tests of their own: they keep to their size and RAM, start, and fulfil their checks."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from eal_actors.kernel.log import get_logger
from evbotos.definitions import load_definitions
from evbotos.run_command import memory_for
from tests.evbotos.proof import answer, built_proof, said, ssh, started, wait_for_words, wait_until

_LOG = get_logger()
NAMES = {
    "qemu-amd64": ("minimal", "dev", "octave"),
    "raspberry-pi-5": ("minimal", "dev", "octave", "vision", "wireless"),
}

pytestmark = [pytest.mark.evbotos, pytest.mark.slow, pytest.mark.timeout(3600)]


@pytest.mark.parametrize(("board", "name"), [(board, name) for board, names in NAMES.items() for name in names])
def test_an_image_starts_and_fulfils_its_checks(board: str, name: str, tmp_path: Path) -> None:
    platform, image = load_definitions().chosen(board, name)
    proof = built_proof(platform, image, tmp_path)
    assert proof.built.report["root_with_kernel_mb"] <= image.budget_mb.root_with_kernel
    disk = Path(shutil.copyfile(proof.built.folder / "disk.img", tmp_path / "disk.img"))
    assert platform.emulator is not None
    with started(proof, disk, memory_mb=memory_for(platform.emulator, image)) as machine:
        wait_for_words(machine, "is up")
        wait_until(machine, "a login", lambda: ssh(proof, machine, "true").returncode == 0)
        up = [line for line in said(machine).splitlines() if "is up" in line]
        _LOG.warning(f"{name}: {up}, {answer(proof, machine, 'free -k')}")
        for command in image.check:
            answer(proof, machine, command)
