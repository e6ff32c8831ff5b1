"""The robot image on the boards that QEMU has, started by Debian's own kernels: only pymunk for armhf is compiled."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from eal_actors.log import get_logger
from evbotos.build import Build
from evbotos.definitions import load_definitions
from evbotos.hosttools import find_tool, needed_for
from evbotos.model import PackagedKernel
from evbotos.qemu import Machine
from tests.evbotos.odometer import built_module
from tests.evbotos.proof import Proof, answer, eal, first_answer_s, give_keys, started

_FILES = ("squashfs", "overlay", "vfat", "nls_cp437", "nls_ascii")
_EXT4 = ("crc32c_generic", "ext4")
KERNELS = {
    "beagle-armhf": PackagedKernel(
        package="linux-image-armmp",
        modules=("ahci_sunxi", "sd_mod", "mdio_sun4i", "sun4i_emac", *_FILES, *_EXT4),
        device_trees=("sun4i-a10-cubieboard.dtb",),
    ),
    "pc104-i686": PackagedKernel(package="linux-image-686", modules=("ata_piix", "sd_mod", "e1000", *_FILES, *_EXT4)),
    "qemu-arm64": PackagedKernel(
        package="linux-image-cloud-arm64",
        modules=("virtio_pci", "virtio_blk", "virtio_net", "virtio_rng", *_FILES, *_EXT4),
    ),
}
_LOG = get_logger()

pytestmark = [pytest.mark.evbotos, pytest.mark.slow, pytest.mark.timeout(3600)]


@pytest.fixture(scope="module", params=sorted(KERNELS))
def proof(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Proof:
    """The robot image of a board, of the packages that the archive offers now."""
    found = load_definitions()
    image = found.image("robot")
    platform = found.platform(request.param).model_copy(update={"kernel": KERNELS[request.param]})
    assert platform.emulator is not None
    missing = [name for name in (*needed_for(platform), platform.emulator.program, "ssh") if find_tool(name) is None]
    if missing:
        pytest.skip(f"not installed: {', '.join(missing)} (make evbotos-setup)")
    folder = tmp_path_factory.mktemp(platform.name)
    fleet, local = give_keys(folder)
    built = Build(platform, image, local, _LOG.info, folder / "locks").run(folder / "out", update_lock=True)
    _LOG.warning(f"{platform.name}: root and kernel {built.report['root_with_kernel_mb']} MB")
    return Proof(platform, image, built, fleet, folder / "robot", folder / "ssh", folder / "update.pem")


@pytest.fixture(scope="module")
def machine(proof: Proof) -> Iterator[Machine]:
    with started(proof, proof.built.folder / "disk.img") as machine:
        yield machine


def test_a_robot_on_the_board_drives_the_square_for_a_controller_outside(
    proof: Proof, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    took_s = first_answer_s(proof, machine, monkeypatch)
    _LOG.warning(f"{proof.platform.name}: first answer after {took_s:.1f} s, computed {machine.computed_s():.1f} s")
    runs = proof.fleet.with_name("runs")
    scenario = Path("scenarios/square.yaml").resolve()
    told = eal("run", scenario, "--fleet", proof.fleet, "--runs-dir", runs, EVBOT_PORT=str(machine.ports["eal"]))
    assert "done" in told
    assert "failed" not in told


def test_who_has_the_key_may_log_in_and_finds_what_the_image_promises(proof: Proof, machine: Machine) -> None:
    _LOG.warning(f"{proof.platform.name}: {answer(proof, machine, 'uname -a; free -k; cat /run/evbotos/robot.up')}")
    assert "/dev/" in answer(proof, machine, "grep ' /data ext4' /proc/mounts")
    for command in proof.image.check:
        answer(proof, machine, command)


def test_a_module_of_the_sdk_is_loaded_on_the_board(proof: Proof, machine: Machine, tmp_path: Path) -> None:
    if proof.platform.name != "beagle-armhf":
        pytest.skip("the module is compiled for the BeagleBoard")
    module = built_module(tmp_path)
    answer(proof, machine, f"cat > /run/{module.name}", module.read_bytes())
    program = "import platform, odometer; print(platform.machine(), odometer.distance(3, 4))"
    assert answer(proof, machine, f"cd /run && python3 -c '{program}'") == "armv7l 5.0\n"
