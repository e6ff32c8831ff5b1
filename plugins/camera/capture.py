"""The interface of an open source of pictures, and helpers for all kinds.

A capture raises `OSError` if the source is absent or lost and may come back, and `EOFError` at its end.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Final, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

Image: TypeAlias = NDArray[np.uint8]
"""A picture in OpenCV's format: (height, width, 3), rows from the top, blue first."""

LEAST_FPS: Final = 1.0
MOST_FPS: Final = 1000.0

_SAME_FPS: Final = 0.01  # 29.97 counts as 30


class Capture:
    """An open source. Thread: the reader's only."""

    period_s: float | None
    """Real seconds between pictures, for a source without its own timing."""

    def read(self) -> Image:
        """Return the next picture, in an array that is not written again.

        Raises:
            EOFError: the source has ended.
            OSError: the source is lost.

        Thread: blocks the caller until the source delivers.
        """
        raise NotImplementedError

    def mode(self) -> dict[str, float]:
        """Return its width, height, fps and exposure, as far as it reports them."""
        raise NotImplementedError

    def adjust(self, wishes: Mapping[str, float]) -> list[str]:
        """Set some of width, height, fps and exposure; return messages on the refused ones."""
        raise NotImplementedError

    def release(self) -> None:
        """Close the source."""
        raise NotImplementedError


class LiveCapture(Capture):
    """A camera or stream that delivers pictures in its own time.

    Args:
        capture: an open `cv2.VideoCapture`.
    """

    period_s = None
    lost: ClassVar[str]
    """Why no picture comes, for messages."""

    def __init__(self, capture: Any) -> None:
        self._capture = capture

    @override
    def read(self) -> Image:
        is_read, image = self._capture.read()
        if not is_read:
            raise OSError(self.lost)
        return np.asarray(image, np.uint8)

    @override
    def release(self) -> None:
        self._capture.release()


def real_s() -> float:
    """Return OpenCV's steady clock. A camera runs in real time, independent of the fleet's clock."""
    return float(cv2.getTickCount() / cv2.getTickFrequency())


def is_same_fps(one: float, other: float) -> bool:
    """Return whether two frame rates are equal, except for rounding."""
    return abs(one - other) <= _SAME_FPS * max(one, other)


def fps_of(capture: Any) -> dict[str, float]:
    """Return the frame rate of a VideoCapture under `fps`, if it is plausible."""
    fps = float(capture.get(cv2.CAP_PROP_FPS))
    return {"fps": fps} if LEAST_FPS <= fps <= MOST_FPS else {}


def size_of(capture: Any) -> dict[str, float]:
    """Return the width and height of a VideoCapture."""
    return {"width": capture.get(cv2.CAP_PROP_FRAME_WIDTH), "height": capture.get(cv2.CAP_PROP_FRAME_HEIGHT)}


def refuse_all(what: str, has: Mapping[str, float | None], wishes: Mapping[str, float]) -> list[str]:
    """Return messages that refuse each wish that differs from the present settings; `what` names the source in them.

    A present setting of None is unsupported.
    """
    refused = []
    for key, wish in wishes.items():
        found = has.get(key)
        if found is None:
            refused.append(f"{key}: a {what} has no such setting")
        elif not (is_same_fps(wish, found) if key == "fps" else wish == found):
            refused.append(f"{key}: a {what} has a fixed value, {found:g}, and cannot have {wish:g}")
    return refused
