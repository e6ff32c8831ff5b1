"""A robot with a USB camera: the image `vision` takes pictures for a controller."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from eal_actors import Fleet
from eal_actors.kernel.errors import EALError
from evbotos.definitions import load_definitions
from evbotos.run_command import memory_for
from tests.evbotos.proof import FLEET, ROBOT, Proof, built_proof, started, wait_until
from tests.evbotos.usb_camera import HEIGHT, WIDTH, UsbCamera

SIM = "sim: {model: evbot3}"
CAMERA = "camera: {source: /dev/v4l/by-id/usb-1d6b_Emulated_Camera-video-index0, timeout_s: 30, frozen_after_s: 60}"

pytestmark = [pytest.mark.evbotos, pytest.mark.slow, pytest.mark.timeout(1800)]


@pytest.fixture(scope="module")
def proof(tmp_path_factory: pytest.TempPathFactory) -> Proof:
    """The image with OpenCV."""
    platform, image = load_definitions().chosen("qemu-amd64", "vision")
    assert SIM in FLEET
    return built_proof(platform, image, tmp_path_factory.mktemp("camera"), fleet_text=FLEET.replace(SIM, CAMERA))


def test_a_camera_that_is_plugged_in_takes_pictures_for_a_controller_outside(
    proof: Proof, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = Path(shutil.copyfile(proof.built.folder / "disk.img", tmp_path / "disk.img"))
    assert proof.platform.emulator is not None
    memory_mb = memory_for(proof.platform.emulator, proof.image)
    with started(proof, disk, memory_mb=memory_mb) as machine, UsbCamera(tmp_path / "usb") as camera:
        camera.plug_into(machine)
        monkeypatch.setenv("EVBOT_PORT", str(machine.ports["eal"]))
        pictures: list[npt.NDArray[np.uint8]] = []
        with Fleet.load(proof.fleet) as fleet:

            def has_pictures() -> bool:
                try:
                    pictures.append(fleet[ROBOT]["Camera"].get_value(timeout_s=20).get().value)
                except EALError:
                    return False
                return len(pictures) == 2

            wait_until(machine, "two pictures", has_pictures)
    for picture in pictures:
        assert picture.shape == (HEIGHT, WIDTH, 3)
        ramp = picture[5, :, 1].astype(int)  # grey, from black to white
        assert ramp[0] < 5
        assert ramp[-1] > 250
        assert (np.diff(ramp) >= 0).all()
    assert (pictures[0] != pictures[1]).any()
