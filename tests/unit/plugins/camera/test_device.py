"""USB cameras: a device that is away, and how a camera is asked for what it may refuse."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from eal_actors.kernel.errors import NotReadyError
from plugins.camera.device import CaptureDevice, open_device
from tests.unit.plugins.camera.rig import camera_on, run

AUTOMATIC, MANUAL = 3.0, 1.0
SIZES = {(640, 480): 30.0, (1280, 720): 10.0}


class UsbCamera:
    """V4L2 through OpenCV: selects the nearest supported value without an error."""

    def __init__(self) -> None:
        self.has = {
            cv2.CAP_PROP_FRAME_WIDTH: 640.0,
            cv2.CAP_PROP_FRAME_HEIGHT: 480.0,
            cv2.CAP_PROP_FPS: 30.0,
            cv2.CAP_PROP_AUTO_EXPOSURE: AUTOMATIC,
            cv2.CAP_PROP_EXPOSURE: 150.0,
            cv2.CAP_PROP_FOURCC: float(cv2.VideoWriter.fourcc(*"YUYV")),
            cv2.CAP_PROP_BUFFERSIZE: 4.0,
        }
        self.codes = {"YUYV", "MJPG"}
        self.is_plugged_in = True
        self.restarts = 0
        self._width: float | None = None

    def get(self, key: int) -> float:
        return self.has[key]

    def set(self, key: int, value: float) -> bool:
        if key == cv2.CAP_PROP_FRAME_WIDTH:
            self._width = value
        elif key == cv2.CAP_PROP_FRAME_HEIGHT and self._width is not None:
            wanted = np.array([self._width, value])
            width, height = min(SIZES, key=lambda size: float(np.abs(wanted - size).sum()))
            self.has[cv2.CAP_PROP_FRAME_WIDTH], self.has[cv2.CAP_PROP_FRAME_HEIGHT] = width, height
            self.has[cv2.CAP_PROP_FPS] = SIZES[width, height]
            self.restarts += 1
        elif key == cv2.CAP_PROP_FPS:
            self.has[key] = min(value, SIZES[int(self.has[3]), int(self.has[4])])
        elif key == cv2.CAP_PROP_FOURCC:
            if int(value).to_bytes(4, "little").decode() in self.codes:
                self.has[key] = value
        elif key == cv2.CAP_PROP_EXPOSURE:
            if self.has[cv2.CAP_PROP_AUTO_EXPOSURE] == MANUAL:
                self.has[key] = min(max(value, 50.0), 1000.0)
        else:
            self.has[key] = value
        return True

    def read(self) -> tuple[bool, np.ndarray | None]:
        return (True, np.zeros((480, 640, 3), np.uint8)) if self.is_plugged_in else (False, None)

    def release(self) -> None:
        self.is_plugged_in = False


def test_a_device_that_is_away_is_not_ready(tmp_path: Path) -> None:
    with camera_on({"source": "/dev/eal-no-such-camera"}) as camera:  # no error: it may be plugged in later
        with pytest.raises(NotReadyError, match=r"^/dev/eal-no-such-camera: there is no such device; .*; next try in"):
            run(camera.get_value())
        assert camera.not_ready() is not None


def test_a_number_is_a_device() -> None:
    with (
        camera_on({"source": 977}) as camera,
        pytest.raises(NotReadyError, match="/dev/video977: there is no such dev"),
    ):
        run(camera.get_value())


def test_a_device_that_does_not_capture_says_so() -> None:
    with camera_on({"source": "/dev/null"}) as camera, pytest.raises(NotReadyError, match="not a capture device"):
        run(camera.get_value())


def test_a_file_is_no_device(tmp_path: Path) -> None:
    (tmp_path / "video0").touch()
    with pytest.raises(OSError, match="it is not a device"):
        open_device(str(tmp_path / "video0"), None)


def test_no_picture_waits_in_a_queue() -> None:
    camera = UsbCamera()
    CaptureDevice(camera, None)
    assert camera.get(cv2.CAP_PROP_BUFFERSIZE) == 1


def test_an_unplugged_camera_is_lost() -> None:
    camera = UsbCamera()
    device = CaptureDevice(camera, None)
    assert device.read().shape == (480, 640, 3)
    camera.is_plugged_in = False
    with pytest.raises(OSError, match="was it unplugged"):
        device.read()


def test_the_coding_is_asked_for_and_looked_at() -> None:
    camera = UsbCamera()
    CaptureDevice(camera, "MJPG")
    assert int(camera.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little") == b"MJPG"
    with pytest.raises(OSError, match="it does not encode its pictures as H264, but as MJPG"):
        CaptureDevice(camera, "H264")
    assert not camera.is_plugged_in  # it is let go of


def test_width_and_height_are_asked_for_together() -> None:
    camera = UsbCamera()
    device = CaptureDevice(camera, None)
    assert device.adjust({"width": 1280, "height": 720}) == []
    assert device.mode() == {"width": 1280, "height": 720, "fps": 10, "exposure": 1}
    assert (camera.get(3), camera.get(4)) == (1280, 720)


def test_a_size_that_is_there_does_not_stop_the_camera() -> None:
    camera = UsbCamera()
    assert CaptureDevice(camera, None).adjust({"width": 640, "height": 480}) == []
    assert camera.restarts == 0


def test_a_size_that_is_refused_is_told_and_the_old_one_stays() -> None:
    camera = UsbCamera()
    assert CaptureDevice(camera, None).adjust({"width": 700}) == [
        "width: the camera has no 700 px there, the nearest is 640 x 480 px"
    ]
    assert (camera.get(3), camera.get(4)) == (640, 480)


def test_a_rate_that_is_refused_is_told() -> None:
    device = CaptureDevice(UsbCamera(), None)
    assert device.adjust({"fps": 15}) == []
    assert device.adjust({"width": 1280, "height": 720, "fps": 30}) == [
        "fps: the camera has no 30 Hz at this size, but 10 Hz"
    ]
    assert device.mode()["fps"] == 10


def test_exposure_is_a_factor_on_what_the_camera_had() -> None:
    camera = UsbCamera()
    device = CaptureDevice(camera, None)
    assert device.mode()["exposure"] == 1.0
    assert device.adjust({"exposure": 2.0}) == []
    assert (camera.get(cv2.CAP_PROP_AUTO_EXPOSURE), camera.get(cv2.CAP_PROP_EXPOSURE)) == (MANUAL, 300.0)
    assert device.mode()["exposure"] == 2.0
    assert device.adjust({"exposure": 1.0}) == []
    assert camera.get(cv2.CAP_PROP_AUTO_EXPOSURE) == AUTOMATIC


def test_an_exposure_that_is_refused_is_told_and_the_old_one_stays() -> None:
    camera = UsbCamera()
    device = CaptureDevice(camera, None)
    device.adjust({"exposure": 2.0})
    assert device.adjust({"exposure": 16.0}) == [
        "exposure: the camera does not take 16 times its own, the nearest is 6.66667"
    ]
    assert device.mode()["exposure"] == 2.0


def test_a_camera_without_exposure_takes_none() -> None:
    camera = UsbCamera()
    camera.has[cv2.CAP_PROP_EXPOSURE] = -1.0
    device = CaptureDevice(camera, None)
    assert device.mode()["exposure"] == 1.0
    assert device.adjust({"exposure": 2.0}) == ["exposure: the camera does not report its own, and takes none"]
