"""A USB or built-in camera through Video4Linux."""

from __future__ import annotations

import os
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import cv2
from typing_extensions import override

from .capture import LiveCapture, fps_of, is_same_fps, size_of

_MANUAL: Final = 1.0
"""The exposure mode of V4L2 with a manual exposure time (V4L2_EXPOSURE_MANUAL)."""

_SAME_EXPOSURE: Final = 0.1  # devices have discrete steps


def open_device(path: str, fourcc: str | None) -> CaptureDevice:
    """Open a camera by its device path.

    Args:
        path: such as `/dev/video0`, or a link to it below `/dev/v4l/by-id`.
        fourcc: four letters of the encoding, such as MJPG; None to keep the present one.

    Raises:
        OSError: it is absent, not permitted, in use, or does not support the encoding.
    """
    _require_usable(Path(path))
    capture = cv2.VideoCapture(path, cv2.CAP_V4L2)
    if not capture.isOpened():
        capture.release()
        raise OSError("it is in use by another program, or is not a capture device")
    return CaptureDevice(capture, fourcc)


def _require_usable(path: Path) -> None:
    """Raise OSError with a reason that OpenCV does not report."""
    if not path.exists():
        raise OSError("there is no such device; is it plugged in?")
    if not stat.S_ISCHR(path.stat().st_mode):
        raise OSError("it is not a device")
    if not os.access(path, os.R_OK | os.W_OK):
        raise OSError("no permission; its user must be in the group `video`")


class CaptureDevice(LiveCapture):
    """An open camera.

    Args:
        capture: an open `cv2.VideoCapture`.
        fourcc: see `open_device`.

    Raises:
        OSError: it does not support the encoding; the capture is released.
    """

    lost = "it no longer delivers pictures; was it unplugged?"

    def __init__(self, capture: Any, fourcc: str | None) -> None:
        super().__init__(capture)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # no queue of old pictures
        if fourcc is not None:
            wanted = cv2.VideoWriter.fourcc(*fourcc)
            capture.set(cv2.CAP_PROP_FOURCC, wanted)
            if int(capture.get(cv2.CAP_PROP_FOURCC)) != wanted:
                found = (
                    int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little", signed=True).decode(errors="replace")
                )
                capture.release()
                raise OSError(f"it does not encode its pictures as {fourcc}, but as {found}")
        self._automatic = capture.get(cv2.CAP_PROP_AUTO_EXPOSURE)
        self._normal_exposure = capture.get(cv2.CAP_PROP_EXPOSURE)

    @override
    def mode(self) -> dict[str, float]:
        return {**size_of(self._capture), **fps_of(self._capture), "exposure": self._exposure()}

    @override
    def adjust(self, wishes: Mapping[str, float]) -> list[str]:
        refused = []  # width and height are set together, because the device has a list of sizes
        size = {key: wishes[key] for key in ("width", "height") if key in wishes}
        if size:
            refused += self._adjust_size(size)
        if "fps" in wishes:
            self._capture.set(cv2.CAP_PROP_FPS, wishes["fps"])
            found = self._capture.get(cv2.CAP_PROP_FPS)
            if not is_same_fps(found, wishes["fps"]):
                refused.append(f"fps: the camera has no {wishes['fps']:g} Hz at this size, but {found:g} Hz")
        if "exposure" in wishes:
            refused += self._adjust_exposure(wishes["exposure"])
        return refused

    def _set_size(self, size: Mapping[str, float]) -> None:
        self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, size["width"])  # takes effect with the height
        self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size["height"])

    def _adjust_size(self, wishes: Mapping[str, float]) -> list[str]:
        before = size_of(self._capture)
        if all(before[key] == wish for key, wish in wishes.items()):
            return []  # a camera that streams stops for a new size
        self._set_size({**before, **wishes})
        found = size_of(self._capture)
        if all(found[key] == wish for key, wish in wishes.items()):
            return []
        self._set_size(before)
        return [
            f"{key}: the camera has no {wish:g} px there, the nearest is {found['width']:g} x {found['height']:g} px"
            for key, wish in wishes.items()
            if found[key] != wish
        ]

    def _exposure(self) -> float:
        """Return the exposure as a factor on that with which it was opened; 1 while it chooses by itself."""
        is_manual = self._capture.get(cv2.CAP_PROP_AUTO_EXPOSURE) == _MANUAL
        if not is_manual or self._normal_exposure <= 0:
            return 1.0
        return float(self._capture.get(cv2.CAP_PROP_EXPOSURE) / self._normal_exposure)

    def _adjust_exposure(self, factor: float) -> list[str]:
        if factor == 1.0:
            self._capture.set(cv2.CAP_PROP_EXPOSURE, self._normal_exposure)
            self._capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, self._automatic)
            return []
        if self._normal_exposure <= 0:
            return ["exposure: the camera does not report its own, and takes none"]
        before = {key: self._capture.get(key) for key in (cv2.CAP_PROP_EXPOSURE, cv2.CAP_PROP_AUTO_EXPOSURE)}
        self._capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL)
        self._capture.set(cv2.CAP_PROP_EXPOSURE, round(self._normal_exposure * factor))
        found = self._exposure()
        if self._capture.get(cv2.CAP_PROP_AUTO_EXPOSURE) == _MANUAL and abs(found - factor) <= _SAME_EXPOSURE * factor:
            return []
        for key, value in before.items():
            self._capture.set(key, value)
        return [f"exposure: the camera does not take {factor:g} times its own, the nearest is {found:g}"]
