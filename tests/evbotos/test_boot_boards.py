"""The robot image on the boards that QEMU has, with kernels of our own and the boards' own boot loaders."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from eal_actors.kernel.log import get_logger
from evbotos.definitions import load_definitions
from evbotos.qemu import Machine
from tests.evbotos.odometer import built_module
from tests.evbotos.power_cuts import prove_cut_starts, prove_cut_update
from tests.evbotos.proof import (
    SERVES,
    Proof,
    answer,
    built_proof,
    first_answer_s,
    started,
    wait_for_words,
)
from tests.evbotos.proofs import prove_square, prove_stick, prove_updates
from tests.evbotos.refusals import prove_refusal
from tests.evbotos.test_buses import AS_USER, does

BOARDS = ("beagle-armhf", "pc104-i686", "qemu-arm64", "raspberry-pi", "raspberry-pi-5")
SEED = 7
SET_CHANNEL = """
import pathlib
channel = pathlib.Path("/sys/class/pwm/pwmchip0/pwm0")
for name, value in (("period", 20_000_000), ("duty_cycle", 1_500_000), ("enable", 1)):
    channel.joinpath(name).write_text(str(value))
print(*(channel.joinpath(name).read_text().strip() for name in ("period", "duty_cycle", "enable")))
"""
_LOG = get_logger()

pytestmark = [pytest.mark.evbotos, pytest.mark.slow, pytest.mark.timeout(3600)]


@pytest.fixture(scope="module", params=BOARDS)
def proof(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Proof:
    """The robot image of a board."""
    found = load_definitions()
    return built_proof(found.platform(request.param), found.image("robot"), tmp_path_factory.mktemp(request.param))


@pytest.fixture(scope="module")
def machine(proof: Proof, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    disk = tmp_path_factory.mktemp("disk") / "disk.img"
    shutil.copyfile(proof.built.folder / "disk.img", disk)
    with started(proof, disk) as machine:
        yield machine


def test_a_robot_on_the_board_drives_the_square_for_a_controller_outside(
    proof: Proof, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    took_s = first_answer_s(proof, machine, monkeypatch)
    _LOG.warning(f"{proof.platform.name}: first answer after {took_s:.1f} s, computed {machine.computed_s():.1f} s")
    prove_square(proof, machine)


def test_who_has_the_key_may_log_in_and_finds_what_the_image_promises(proof: Proof, machine: Machine) -> None:
    wait_for_words(machine, SERVES)
    _LOG.warning(f"{proof.platform.name}: {answer(proof, machine, 'uname -a; free -k; cat /run/evbotos/robot.up')}")
    assert "/dev/" in answer(proof, machine, "grep ' /data ext4' /proc/mounts")
    for command in proof.image.check:
        answer(proof, machine, command)


def test_a_module_of_the_sdk_is_loaded_on_the_board(proof: Proof, machine: Machine, tmp_path: Path) -> None:
    machine_name = {"beagle-armhf": "armv7l", "raspberry-pi-5": "aarch64"}.get(proof.platform.name)
    if machine_name is None:
        pytest.skip("one board of each suite is enough")
    wait_for_words(machine, SERVES)
    module = built_module(proof.platform, tmp_path)
    answer(proof, machine, f"cat > /run/{module.name}", module.read_bytes())
    program = "import platform, odometer; print(platform.machine(), odometer.distance(3, 4))"
    assert answer(proof, machine, f"cd /run && python3 -c '{program}'") == f"{machine_name} 5.0\n"


def test_the_robots_user_sets_a_pwm_channel(proof: Proof, machine: Machine) -> None:
    if proof.platform.name != "raspberry-pi":
        pytest.skip("QEMU has no PWM of this board")
    wait_for_words(machine, SERVES)
    answer(proof, machine, "cat >/run/as_user.py", AS_USER.encode())
    assert does((proof, machine), SET_CHANNEL) == "20000000 1500000 1"
    assert "Permission denied" in does((proof, machine), SET_CHANNEL, "mdns")


def test_a_stick_with_a_fleet_file_makes_another_robot_of_the_board(
    proof: Proof, machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prove_stick(proof, machine, tmp_path, monkeypatch)


def test_updates_of_the_board_are_refused_tried_and_fallen_back_from(proof: Proof, tmp_path: Path) -> None:
    disk = Path(shutil.copyfile(proof.built.folder / "disk.img", tmp_path / "disk.img"))
    with started(proof, disk) as machine:
        prove_updates(proof, machine, tmp_path)


@pytest.mark.parametrize("seed", range(6))
def test_a_refused_update_never_starts_on_the_board(proof: Proof, tmp_path: Path, seed: int) -> None:
    disk = Path(shutil.copyfile(proof.built.folder / "disk.img", tmp_path / "disk.img"))
    prove_refusal(proof, disk, tmp_path, seed)


def test_the_power_may_go_at_any_instant_of_a_start(proof: Proof, tmp_path: Path) -> None:
    disk = Path(shutil.copyfile(proof.built.folder / "disk.img", tmp_path / "disk.img"))
    prove_cut_starts(proof, disk, SEED)


@pytest.mark.parametrize("seed", range(6))
def test_the_power_may_go_at_any_instant_of_an_update(proof: Proof, tmp_path: Path, seed: int) -> None:
    disk = Path(shutil.copyfile(proof.built.folder / "disk.img", tmp_path / "disk.img"))
    prove_cut_update(proof, disk, tmp_path, seed)
