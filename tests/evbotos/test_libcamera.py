"""Pictures through libcamera: the image `libcamera` with the kernel's virtual camera, for a controller outside."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from eal_actors import Fleet
from eal_actors.kernel.errors import EALError
from eal_actors.kernel.log import get_logger
from evbotos.definitions import load_definitions
from evbotos.qemu import Machine
from evbotos.run_command import memory_for
from tests.evbotos.proof import FLEET, ROBOT, SERVES, Proof, answer, built_proof, started, wait_for_words, wait_until

WIDTH, HEIGHT = 480, 360  # the virtual camera has multiples of six
SOURCE = (
    'gst-launch-1.0, -f, -q, libcamerasrc, "!", "video/x-raw,width=480,height=360", "!", '
    'videoconvert, "!", jpegenc, "!", fdsink'
)
SIM = "sim: {model: evbot3}"
CAMERA = f"camera: {{source: [{SOURCE}], timeout_s: 60, frozen_after_s: null}}"
BARS = np.array([[*map(int, bar)] for bar in ("111", "110", "011", "010", "101", "100", "001", "000")], bool)
"""Red, green and blue of the virtual sensor's pattern: white, yellow, cyan, green, magenta, red, blue, black."""
DRIVER = "/sys/bus/platform/drivers/vimc"
_LOG = get_logger()

pytestmark = [pytest.mark.evbotos, pytest.mark.slow, pytest.mark.timeout(3600)]


@pytest.fixture(scope="module", params=["qemu-amd64", "raspberry-pi-5"])
def machine(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[Proof, Machine]]:
    """A running robot, whose camera is the kernel's virtual one; libcamera is of Debian 12 or 13."""
    folder = tmp_path_factory.mktemp("libcamera")
    platform, image = load_definitions().chosen(request.param, "libcamera")
    proof = built_proof(platform, image, folder, fleet_text=FLEET.replace(SIM, CAMERA))
    assert proof.built.report["root_with_kernel_mb"] <= image.budget_mb.root_with_kernel
    disk = Path(shutil.copyfile(proof.built.folder / "disk.img", folder / "disk.img"))
    assert platform.emulator is not None
    with started(proof, disk, memory_mb=memory_for(platform.emulator, image)) as machine:
        wait_for_words(machine, SERVES.replace("Base", "Camera"))
        yield proof, machine


def has_bars(picture: npt.NDArray[np.uint8]) -> bool:
    """Return whether a picture shows the sensor's bars, each with its colour in its middle."""
    assert picture.shape == (HEIGHT, WIDTH, 3)
    middles = (np.arange(len(BARS)) + 0.5) * WIDTH / len(BARS)
    return bool(((picture[HEIGHT * 3 // 4, middles.astype(int)] > 95) == BARS).all())


def test_a_controller_outside_takes_pictures(machine: tuple[Proof, Machine], monkeypatch: pytest.MonkeyPatch) -> None:
    proof, booted = machine
    for command in proof.image.check:
        answer(proof, booted, command)
    monkeypatch.setenv("EVBOT_PORT", str(booted.ports["eal"]))
    pictures: list[npt.NDArray[np.uint8]] = []
    with Fleet.load(proof.fleet) as fleet:

        def why_not() -> str:
            try:
                pictures.append(fleet[ROBOT]["Camera"].get_value(timeout_s=120).get().value)
            except EALError as error:
                return str(error)
            return ""

        wait_until(booted, "two pictures", lambda: not why_not() and len(pictures) > 1)
        assert (pictures[0] != pictures[1]).any()
        _LOG.warning(answer(proof, booted, "free -m; grep -E '^(Rss|Pss)' /proc/$(pidof gst-launch-1.0)/smaps_rollup"))
        answer(proof, booted, f"echo vimc.0 >{DRIVER}/unbind")
        wait_until(booted, "no camera", lambda: "exit code 255" in why_not())
        answer(proof, booted, f"echo vimc.0 >{DRIVER}/bind")
        wait_until(booted, "another picture", lambda: not why_not())
    assert all(map(has_bars, pictures))
