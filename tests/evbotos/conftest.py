from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from evbotos.build import cache_folder, kernel_key
from evbotos.definitions import load_definitions
from evbotos.lock import read_lock
from evbotos.model import Local, Platform
from evbotos.qemu import Machine
from tests.evbotos.proof import Proof, built_proof, require_tools, started


def has_kernel(platform: Platform, lock_file: Path) -> bool:
    """Return whether the cache holds the kernel, whose compilation takes longest."""
    lock = read_lock(lock_file)
    return lock is not None and (cache_folder(Local(version=1)) / "kernel" / kernel_key(platform, lock)).is_dir()


@pytest.fixture(scope="session")
def proof(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Proof:
    """The robot image for QEMU's PC, with keys of its own."""
    found = load_definitions()
    platform, image = found.platform("qemu-amd64"), found.image("robot")
    require_tools(platform)
    if not (
        has_kernel(platform, found.lock_path(platform, image)) or "evbotos" in request.config.getoption("markexpr")
    ):
        pytest.skip("no kernel in the cache yet; compiling it takes minutes: `make test-evbotos`")
    return built_proof(platform, image, tmp_path_factory.mktemp("proof"))


@pytest.fixture
def disk(proof: Proof, tmp_path: Path) -> Path:
    """A fresh disk of the robot image."""
    return Path(shutil.copyfile(proof.built.folder / "disk.img", tmp_path / "disk.img"))


@pytest.fixture
def machine(proof: Proof, disk: Path) -> Iterator[Machine]:
    """A machine that has just been switched on."""
    with started(proof, disk) as machine:
        yield machine
