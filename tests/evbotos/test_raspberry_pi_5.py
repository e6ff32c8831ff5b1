"""A Raspberry Pi 5: its drivers, firmware and device trees. QEMU has no such board; its `virt` starts the image."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import pytest

from evbotos.definitions import load_definitions
from evbotos.disk import parts_of
from evbotos.qemu import Machine
from evbotos.u_boot import OVERLAYS
from tests.evbotos.proof import SERVES, Proof, answer, built_proof, started, wait_for_words

DRIVERS = {
    "platform": (
        "sdhci-brcmstb",  # the card
        "brcm-pcie",
        "mip_msi",  # its interrupts
        "brcmstb-reset",
        "pinctrl-bcm2712",
        "brcmstb-gpio",
        "bcm2835-wdt",
        "raspberrypi-firmware",
        "macb",  # the network
        "dwc3",  # USB
        "rp1-clk",
        "pinctrl-rp1",
        "i2c_designware",
        "dw_spi_mmio",
        "pwm-gpio",
    ),
    "pci": ("rp1_pci",),
    "sdio": ("brcmfmac",),
    "usb": ("rtl8xxxu",),
}
"""By bus, as the kernel names them."""
CAMERA_DRIVERS = {"platform": ("rp1-cfe", "pispbe"), "i2c": ("imx219", "imx296", "ov5647")}

pytestmark = [pytest.mark.evbotos, pytest.mark.slow, pytest.mark.timeout(3600)]


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Proof, Machine]]:
    """A started machine with the image `wireless`."""
    folder = tmp_path_factory.mktemp("pi5")
    platform, image = load_definitions().chosen("raspberry-pi-5", "wireless")
    proof = built_proof(platform, image, folder)
    disk = Path(shutil.copyfile(proof.built.folder / "disk.img", folder / "disk.img"))
    with started(proof, disk) as machine:
        wait_for_words(machine, SERVES)
        yield proof, machine


def missing_drivers(proof: Proof, booted: Machine, wanted: Mapping[str, Iterable[str]]) -> dict[str, set[str]]:
    """Return the drivers that a kernel lacks, by bus."""
    return {
        bus: missing
        for bus, names in wanted.items()
        if (missing := set(names) - set(answer(proof, booted, f"ls /sys/bus/{bus}/drivers").split()))
    }


def test_the_kernel_has_the_boards_drivers(machine: tuple[Proof, Machine]) -> None:
    assert not missing_drivers(*machine, DRIVERS)


def test_the_kernel_of_images_with_libcamera_has_the_drivers_of_cameras_too(tmp_path: Path) -> None:
    found = load_definitions()
    platform, image = found.platform("raspberry-pi-5"), found.image("robot")
    kernel = found.chosen("raspberry-pi-5", "libcamera")[0].kernel
    proof = built_proof(platform.model_copy(update={"kernel": kernel}), image, tmp_path)
    with started(proof, proof.built.folder / "disk.img") as booted:
        wait_for_words(booted, SERVES)
        assert not missing_drivers(proof, booted, {**CAMERA_DRIVERS, "pci": DRIVERS["pci"]})
        heap = "stat -c '%U %G %a' /dev/dma_heap/default_cma_region"
        assert answer(proof, booted, heap) == "root video 660\n"


def test_the_radio_finds_its_firmware_and_settings(machine: tuple[Proof, Machine]) -> None:
    proof, booted = machine
    for name in ("bin", "clm_blob", "raspberrypi,5-model-b.txt"):
        answer(proof, booted, f"test -s /lib/firmware/brcm/brcmfmac43455-sdio.{name}")


def test_the_overlay_makes_the_kernels_own_tree_of_newer_steppings(
    machine: tuple[Proof, Machine], tmp_path: Path
) -> None:
    proof, _ = machine
    place = f"{proof.built.folder / 'disk.img'}@@{parts_of(proof.image.layout).boot[0]}"
    older, newer, overlay = "bcm2712-rpi-5-b.dtb", "bcm2712-d-rpi-5-b.dtb", "bcm2712d0.dtbo"
    for name in (older, newer, f"{OVERLAYS}/{overlay}"):
        subprocess.run(["mcopy", "-i", place, f"::/{name}", tmp_path], check=True)
    subprocess.run(["fdtoverlay", "-i", tmp_path / older, "-o", tmp_path / "made", tmp_path / overlay], check=True)
    made, own = (source(tmp_path / name) for name in ("made", newer))
    assert made == own
    assert made != source(tmp_path / older)


def source(tree: Path) -> list[str]:
    """Return a device tree as text without the names of lines, which are for people."""
    argv = ["dtc", "-q", "-s", "-I", "dtb", "-O", "dts", str(tree)]
    text = subprocess.run(argv, capture_output=True, text=True, check=True).stdout
    return [line for line in text.splitlines() if "gpio-line-names" not in line]
