"""The image `vision` in the RAM that it states: the thesis's scenarios, unchanged, against a booted robot."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.kernel.errors import EALError
from eal_actors.kernel.log import get_logger
from evbotos.definitions import load_definitions
from evbotos.qemu import Machine
from evbotos.run_command import memory_for
from tests.evbotos.proof import (
    DEBIAN_KERNEL,
    FLEET,
    ROBOT,
    SERVES,
    Proof,
    answer,
    built_proof,
    compressed_quickly,
    started,
    wait_for_words,
    wait_until,
)

UNREACHABLE = 3
"""The exit code of a run whose robot does not answer."""
_LOG = get_logger()

pytestmark = [pytest.mark.evbotos, pytest.mark.timeout(3600)]


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Proof, Machine]]:
    """A running robot with a simulated camera in the laboratory, started by Debian's own kernel."""
    folder = tmp_path_factory.mktemp("vision")
    board, image = load_definitions().chosen("qemu-amd64", "vision")
    platform = board.model_copy(update={"kernel": DEBIAN_KERNEL})
    in_lab = FLEET.replace("name: proof", "name: proof\nworld: lab")
    with compressed_quickly():
        proof = built_proof(platform, image, folder, fleet_text=in_lab, current_packages=True)
    disk = Path(shutil.copyfile(proof.built.folder / "disk.img", folder / "disk.img"))
    assert platform.emulator is not None
    with started(proof, disk, memory_mb=memory_for(platform.emulator, image)) as machine:
        wait_for_words(machine, SERVES)
        yield proof, machine


def run_scenario(machine: Machine, *words: str | Path) -> str:
    """Run a scenario as soon as the robot answers in time, which an emulator on a busy computer does not at once."""
    argv = [sys.executable, "-m", "eal_actors", "run", *map(str, words)]
    env = {**os.environ, "EVBOT_PORT": str(machine.ports["eal"])}
    done: list[subprocess.CompletedProcess[str]] = []

    def is_reached() -> bool:
        done.append(subprocess.run(argv, env=env, capture_output=True, text=True, timeout=1800, check=False))
        return done[-1].returncode != UNREACHABLE

    wait_until(machine, "the robot answers", is_reached)
    assert done[-1].returncode == 0, done[-1].stdout + done[-1].stderr
    return done[-1].stdout


def take_first_picture(proof: Proof, machine: Machine) -> None:
    """Wait for the first picture of the simulated room: an emulated processor draws the room for a minute."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EVBOT_PORT", str(machine.ports["eal"]))
        with Fleet.load(proof.fleet) as fleet:

            def is_taken() -> bool:
                try:
                    fleet[ROBOT]["Camera"].get_value(timeout_s=600).get()
                except EALError:
                    return False
                return True

            wait_until(machine, "the first picture", is_taken)


@pytest.mark.parametrize("scenario", ["square", "panorama", "dance"])
def test_a_scenario_of_the_thesis_runs_unchanged(machine: tuple[Proof, Machine], tmp_path: Path, scenario: str) -> None:
    proof, booted = machine
    if scenario == "panorama":
        take_first_picture(proof, booted)
    said = run_scenario(booted, scenario, "--fleet", proof.fleet, "--runs-dir", tmp_path, "--no-plot")
    assert f"{scenario} on proof: done" in said
    _LOG.warning(f"{scenario}: {answer(proof, booted, 'free -m')}")
    if scenario == "panorama":
        run = max(tmp_path.iterdir())
        told = json.loads((run / ROBOT / "panorama.json").read_text())
        assert told["is_full"], told
        assert [frame["left_out"] for frame in told["frames"]] == [None] * 8
