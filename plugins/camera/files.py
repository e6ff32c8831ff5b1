"""Pictures that were taken before: video files and folders of images, played in real time."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from .capture import LEAST_FPS, MOST_FPS, Image, fps_of, is_same_fps, refuse_all

SUFFIXES: Final = (".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp")


class VideoFile:
    """An open video file; see Capture. It plays at its own rate.

    Args:
        path: the file.
        loop: begin anew at the end.

    Raises:
        OSError: it cannot be read as a video.
    """

    def __init__(self, path: Path, *, loop: bool) -> None:
        self._loop = loop
        self._count = 0
        self._capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
        if not self._capture.isOpened():
            self._capture.release()
            raise OSError("it is no video that FFmpeg can read")
        fps = fps_of(self._capture).get("fps")
        if fps is None:
            self._capture.release()
            raise OSError(f"it is no video with a rate of {LEAST_FPS:g} to {MOST_FPS:g} pictures a second")
        self._fps = fps
        self.period_s: float | None = 1.0 / fps

    def read(self) -> Image:
        """See Capture."""
        is_read, image = self._capture.read()
        if not is_read and self._loop and self._count:
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, 0)
            is_read, image = self._capture.read()
            if not is_read:
                raise OSError("it cannot be read from its beginning again")
        if not is_read:
            raise EOFError(f"it has ended after {self._count} pictures; with `loop: true` it begins anew")
        self._count += 1
        return np.asarray(image, np.uint8)

    def mode(self) -> dict[str, float]:
        """See Capture."""
        return {"fps": self._fps, "exposure": 1.0}

    def adjust(self, wishes: Mapping[str, float]) -> list[str]:
        """See Capture."""
        size = {
            "width": self._capture.get(cv2.CAP_PROP_FRAME_WIDTH),
            "height": self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT),
        }
        return refuse_all("video file", {**size, **self.mode()}, wishes)

    def release(self) -> None:
        """See Capture."""
        self._capture.release()


class ImageFolder:
    """A folder of images; see Capture. They come in natural order, 2.png before 10.png.

    Args:
        path: the folder.
        loop: begin anew at the end, with what is in the folder then.
        fps: images a second.

    Raises:
        OSError: there is no image in it.
    """

    def __init__(self, path: Path, *, loop: bool, fps: float) -> None:
        self._path = path
        self._loop = loop
        self._fps = fps
        self._files = self._list()
        self._next = 0
        self._size: dict[str, float] = {}
        self.period_s: float | None = 1.0 / fps

    def read(self) -> Image:
        """See Capture."""
        if self._next == len(self._files):
            if not self._loop:
                raise EOFError(f"it has ended after {self._next} images; with `loop: true` it begins anew")
            self._files, self._next = self._list(), 0
        file = self._files[self._next]
        image = cv2.imread(str(file), cv2.IMREAD_COLOR)
        if image is None:
            raise OSError(f"{file.name} in it is no image that OpenCV can read")
        self._next += 1
        self._size = {"height": image.shape[0], "width": image.shape[1]}
        return np.asarray(image, np.uint8)

    def mode(self) -> dict[str, float]:
        """See Capture."""
        return {"fps": self._fps, "exposure": 1.0}

    def adjust(self, wishes: Mapping[str, float]) -> list[str]:
        """See Capture. The rate can be chosen."""
        if "fps" in wishes and not is_same_fps(wishes["fps"], self._fps):
            self._fps = wishes["fps"]
            self.period_s = 1.0 / self._fps
        return refuse_all("folder of images", {**self._size, **self.mode()}, wishes)

    def release(self) -> None:
        """See Capture: no file is open."""

    def _list(self) -> list[Path]:
        files = sorted((file for file in self._path.iterdir() if file.suffix.lower() in SUFFIXES), key=_natural)
        if not files:
            raise OSError(f"there is no image in it; images end in {', '.join(SUFFIXES)}")
        return files


def _natural(file: Path) -> list[tuple[int, str]]:
    """Return by what a file is sorted: the numbers in its name as numbers, the rest as text."""
    parts = re.split(r"(\d+)", file.name.lower())
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]
