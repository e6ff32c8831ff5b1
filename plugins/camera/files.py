"""Recorded pictures: video files and folders of images, played in real time."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from typing_extensions import override

from .capture import LEAST_FPS, MOST_FPS, Capture, Image, fps_of, is_same_fps, refuse_all, size_of

SUFFIXES: Final = (".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp")


class _Recording(Capture):
    """Recorded pictures at a frame rate."""

    def __init__(self, fps: float) -> None:
        self._fps = fps
        self.period_s: float | None = 1.0 / fps

    @override
    def mode(self) -> dict[str, float]:
        return {"fps": self._fps, "exposure": 1.0}


class VideoFile(_Recording):
    """An open video file. It plays at its own rate.

    Raises:
        OSError: it is not a readable video.
    """

    def __init__(self, path: Path, *, loop: bool) -> None:
        self._loop = loop
        self._count = 0
        self._capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
        if not self._capture.isOpened():
            self._capture.release()
            raise OSError("it is not a video that FFmpeg can read")
        fps = fps_of(self._capture).get("fps")
        if fps is None:
            self._capture.release()
            raise OSError(f"it is not a video with a rate of {LEAST_FPS:g} to {MOST_FPS:g} pictures per second")
        super().__init__(fps)

    @override
    def read(self) -> Image:
        is_read, image = self._capture.read()
        if not is_read and self._loop and self._count:
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, 0)
            is_read, image = self._capture.read()
            if not is_read:
                raise OSError("it cannot be restarted")
        if not is_read:
            raise EOFError(f"it has ended after {self._count} pictures; with `loop: true` it restarts")
        self._count += 1
        return np.asarray(image, np.uint8)

    @override
    def adjust(self, wishes: Mapping[str, float]) -> list[str]:
        return refuse_all("video file", {**size_of(self._capture), **self.mode()}, wishes)

    @override
    def release(self) -> None:
        self._capture.release()


class ImageFolder(_Recording):
    """A folder of images. The order is natural: 2.png before 10.png.

    Args:
        loop: restart at the end, with the present content of the folder.
        fps: images per second.

    Raises:
        OSError: it contains no image.
    """

    def __init__(self, path: Path, *, loop: bool, fps: float) -> None:
        super().__init__(fps)
        self._path = path
        self._loop = loop
        self._files = self._list()
        self._next = 0
        self._size: dict[str, float] = {}

    @override
    def read(self) -> Image:
        if self._next == len(self._files):
            if not self._loop:
                raise EOFError(f"it has ended after {self._next} images; with `loop: true` it restarts")
            self._files, self._next = self._list(), 0
        file = self._files[self._next]
        image = cv2.imread(str(file), cv2.IMREAD_COLOR)
        if image is None:
            raise OSError(f"OpenCV cannot read its image {file.name}")
        self._next += 1
        self._size = {"height": image.shape[0], "width": image.shape[1]}
        return np.asarray(image, np.uint8)

    @override
    def adjust(self, wishes: Mapping[str, float]) -> list[str]:
        if "fps" in wishes and not is_same_fps(wishes["fps"], self._fps):
            self._fps = wishes["fps"]
            self.period_s = 1.0 / self._fps
        return refuse_all("folder of images", {**self._size, **self.mode()}, wishes)

    def release(self) -> None:
        """Do nothing: no file is open."""

    def _list(self) -> list[Path]:
        files = sorted((file for file in self._path.iterdir() if file.suffix.lower() in SUFFIXES), key=_natural_key)
        if not files:
            raise OSError(f"it contains no image; images end in {', '.join(SUFFIXES)}")
        return files


def _natural_key(file: Path) -> list[tuple[int, str]]:
    """Return a sort key that compares the numbers in a name as numbers."""
    parts = re.split(r"(\d+)", file.name.lower())
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]
