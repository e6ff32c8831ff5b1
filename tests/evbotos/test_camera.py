"""A robot with a USB camera: the image `vision` takes pictures for a controller."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from eal_actors import Fleet
from eal_actors.kernel.errors import EALError
from eal_actors.kernel.log import get_logger
from evbotos.build import Build
from evbotos.definitions import load_definitions
from evbotos.run_command import memory_for
from tests.evbotos.proof import FLEET, ROBOT, Proof, give_keys, require_tools, started, wait_until
from tests.evbotos.usb_camera import HEIGHT, WIDTH, UsbCamera

SIM = "sim: {model: evbot3}"
CAMERA = "camera: {source: /dev/v4l/by-id/usb-1d6b_Emulated_Camera-video-index0, timeout_s: 30, frozen_after_s: 60}"
_LOG = get_logger()

pytestmark = [pytest.mark.evbotos, pytest.mark.slow, pytest.mark.timeout(1800)]


@pytest.fixture(scope="module")
def proof(tmp_path_factory: pytest.TempPathFactory) -> Proof:
    """The image with OpenCV."""
    folder = tmp_path_factory.mktemp("camera")
    found = load_definitions()
    platform, image = found.chosen("qemu-amd64", "vision")
    require_tools(platform)
    assert SIM in FLEET
    fleet, local = give_keys(folder, FLEET.replace(SIM, CAMERA))
    build = Build(platform, image, local, found.lock_path(platform, image), _LOG.info)
    built = build.run(folder / "out")
    _LOG.warning(f"with OpenCV: root and kernel {built.report['root_with_kernel_mb']} MB")
    return Proof(platform, image, built, fleet, folder / "robot", folder / "ssh", folder / "update.pem")


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
