"""Raspberry Pis with Wi-Fi and SPI: drivers, firmware and devices, in QEMU, which has neither radios nor an SPI bus."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from evbotos.definitions import load_definitions
from evbotos.qemu import Machine
from tests.evbotos.proof import (
    SERVES,
    Proof,
    answer,
    built_proof,
    ssh,
    started,
    wait_for_words,
    wait_until,
)
from tests.evbotos.test_buses import AS_USER, does

RADIOS = {
    "raspberrypi,3-model-b": "43430",
    "raspberrypi,3-model-b-plus": "43455",
    "raspberrypi,3-model-a-plus": "43455",
    "raspberrypi,4-model-b": "43455",
}
"""The chips, by the names of the boards in their device trees."""

pytestmark = [pytest.mark.evbotos, pytest.mark.slow, pytest.mark.timeout(3600)]


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Proof, Machine]]:
    """A started Raspberry Pi 3 with the image `wireless` and an overlay."""
    folder = tmp_path_factory.mktemp("wifi")
    board, image = load_definitions().chosen("raspberry-pi", "wireless")
    platform = board.model_copy(update={"overlays": ("raspberry-pi-spi.dts",)})
    proof = built_proof(platform, image, folder)
    disk = Path(shutil.copyfile(proof.built.folder / "disk.img", folder / "disk.img"))
    with started(proof, disk) as machine:
        wait_for_words(machine, SERVES)
        yield proof, machine


def test_each_board_with_a_radio_finds_its_firmware_and_settings(machine: tuple[Proof, Machine]) -> None:
    """The driver asks for these names; see brcmf_fw_alloc_request of Linux."""
    proof, booted = machine
    for board, chip in RADIOS.items():
        for name in (f"{chip}-sdio.bin", f"{chip}-sdio.clm_blob", f"{chip}-sdio.{board}.txt"):
            answer(proof, booted, f"test -s /lib/firmware/brcm/brcmfmac{name}")
    assert answer(proof, booted, "cat /proc/device-tree/compatible").split("\0")[0] in RADIOS
    assert answer(proof, booted, "ls /lib/firmware/brcm | wc -l").strip() == "9"


def test_the_kernel_has_the_drivers_of_the_boards_and_of_adapters(machine: tuple[Proof, Machine]) -> None:
    proof, booted = machine
    assert answer(proof, booted, "ls /sys/bus/sdio/drivers").split() == ["brcmfmac"]
    assert "rtl8xxxu" in answer(proof, booted, "ls /sys/bus/usb/drivers")
    assert "country" in answer(proof, booted, "iw reg get")


def test_the_overlay_gives_the_robot_two_spi_devices(machine: tuple[Proof, Machine]) -> None:
    proof, booted = machine
    answer(proof, booted, "cat >/run/as_user.py", AS_USER.encode())
    both = "stat -c %G /dev/spidev0.0 /dev/spidev0.1"
    wait_until(booted, "two devices", lambda: ssh(proof, booted, both).stdout.split() == ["spi", "spi"])
    for number in range(2):
        device = f"/dev/spidev0.{number}"
        assert does(machine, f"print(open('{device}', 'r+b', 0).fileno() > 2)") == "True"
        assert "Permission denied" in does(machine, f"open('{device}')", "mdns")
