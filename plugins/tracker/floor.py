"""The floor from above: the pictures of the cameras, rectified to the world's rectangle."""

from __future__ import annotations

from collections.abc import Generator
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
from typing_extensions import override

from eal_actors.plugin import DataType, EALData, Resource, ResourceType, ValueInfo

from .tracker import Tracker

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .camera_tracker import CameraTracker
    from .mounting import Mounting

_MOST_PX: Final = 800
_PX_PER_M: Final = 100.0
_NOWHERE: Final = -9.0  # a pixel outside any picture


class FloorPicture(Resource):
    """The floor as a map: what stands on it leans away from the cameras.

    Args:
        size_m: of the world's rectangle, along x and y.
    """

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.CHAR, shape=(None, None, 3), description="RGB, the whole world, y up")

    def __init__(self, tracker: Tracker, size_m: tuple[float, float]) -> None:
        self._tracker = tracker
        scale = min(_PX_PER_M, _MOST_PX / max(size_m))
        columns, rows = (max(1, round(size * scale)) for size in size_m)
        x_m = (np.arange(columns) + 0.5) / scale - size_m[0] / 2
        y_m = size_m[1] / 2 - (np.arange(rows) + 0.5) / scale
        self._points = np.stack([*np.meshgrid(x_m, y_m), np.zeros((rows, columns))], axis=-1)
        self._pixels: dict[str, tuple[Mounting, NDArray[np.float32]]] = {}

    @override
    def not_ready(self) -> str | None:
        return self._tracker.why_not_ready()

    def get_value(self) -> EALData | Generator[float, None, EALData]:
        """Return the floor, shape (height, width, 3); black where no camera looks.

        Raises:
            NotReadyError: no camera gives pictures and knows its pose.
        """
        return self._tracker.after_first_picture(self._picture)

    def _picture(self) -> EALData:
        cameras = self._tracker.look(placed=True)
        floor = np.zeros((*self._points.shape[:2], 3), np.uint8)
        for camera in cameras:
            view = cv2.remap(camera.picture, *cv2.split(self._pixels_of(camera)), cv2.INTER_LINEAR)  # type: ignore[call-overload]
            is_dark = ~floor.any(axis=2)
            floor[is_dark] = view[is_dark]
        stamp_s = max(camera.stamp_s for camera in cameras if camera.stamp_s is not None)
        return EALData.of(np.asarray(cv2.cvtColor(floor, cv2.COLOR_BGR2RGB), np.uint8), frame_id="map", stamp_s=stamp_s)

    def _pixels_of(self, camera: CameraTracker) -> NDArray[np.float32]:
        """Return the pixel of each point of the floor; computed anew when the camera was moved."""
        mounting = camera.mounting
        assert mounting is not None  # noqa: S101  # the caller has chosen the camera by it
        known = self._pixels.get(camera.name)
        if known is None or not _is_same(known[0], mounting):
            seen_from = self._points.reshape(-1, 3), mounting.turn, mounting.shift_m
            found = camera.lens.pixels(*seen_from)
            found[~camera.lens.has_in_front(*seen_from)] = _NOWHERE
            known = mounting, found.astype(np.float32).reshape(*self._points.shape[:2], 2)
            self._pixels[camera.name] = known
        return known[1]


def _is_same(one: Mounting, other: Mounting) -> bool:
    """Return whether two estimates of a camera's pose differ by less than a pixel of the picture."""
    return np.allclose(one.turn, other.turn, atol=1e-3) and np.allclose(one.shift_m, other.shift_m, atol=5e-3)
