"""Draws what was found into a picture."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from .camera_tracker import CameraTracker
from .feeds import Image
from .lens import Floats

_GREEN, _YELLOW, _RED, _WHITE, _BLACK = (80, 220, 60), (40, 210, 250), (60, 60, 240), (255, 255, 255), (0, 0, 0)
_FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
_SHIFT: Final = 4  # OpenCV draws in sixteenths of a pixel


def draw(camera: CameraTracker) -> Image:
    """Return a camera's newest picture with its markers, blue, green and red.

    Green: a marker on a robot with its fix, the thick line on its front. Yellow: a marker on the floor. Red: a marker
    that gets no fix.
    """
    if camera.picture is None:
        raise ValueError(f"camera {camera.name} has no picture yet")
    image = camera.picture.copy()
    floor = camera.floor_corners
    for number, corners in floor.items():
        _outline(image, number, corners, _YELLOW)
    for one in camera.detections:
        if one.number not in floor:
            _outline(image, one.number, one.corners, _GREEN if one.number in camera.sightings else _RED)
    fixes = len(camera.sightings)
    stamp = "" if camera.stamp_s is None else f"  {camera.stamp_s:.2f} s"
    pose = "" if camera.mounting is None else f"  floor {len(floor)} markers, {camera.mounting.error_px:.2f} px"
    _write(image, f"{camera.name}  {fixes} robots{pose}{stamp}", np.array([8.0, image.shape[0] - 10.0]), _WHITE)
    return image


def _outline(image: Image, number: int, corners: Floats, colour: tuple[int, ...]) -> None:
    fixed = np.rint(corners * 2**_SHIFT).astype(np.int32)
    cv2.polylines(image, [fixed], isClosed=True, color=colour, thickness=2, lineType=cv2.LINE_AA, shift=_SHIFT)
    cv2.line(image, fixed[1], fixed[2], colour, 5, cv2.LINE_AA, _SHIFT)
    _write(image, str(number), corners.max(axis=0), colour)


def _write(image: Image, text: str, place: Floats, colour: tuple[int, ...]) -> None:
    """Write on a dark ground, so that it is legible on every floor."""
    x, y = round(float(place[0])), round(float(place[1]))
    (width, height), below = cv2.getTextSize(text, _FONT, 0.6, 1)
    cv2.rectangle(image, (x - 2, y - height - 2), (x + width + 2, y + below), _BLACK, cv2.FILLED)
    cv2.putText(image, text, (x, y), _FONT, 0.6, colour, 1, cv2.LINE_AA)
