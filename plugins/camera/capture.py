"""What the reading thread reads from, whatever the kind of source; and what is common to the kinds.

A capture raises what Python raises for files: `OSError` for what is absent or lost and may come back, `EOFError` at the
end of what has one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Protocol, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

Image: TypeAlias = NDArray[np.uint8]
"""A picture as OpenCV has it: (height, width, 3), rows from the top, blue first."""

LEAST_FPS: Final = 1.0
MOST_FPS: Final = 1000.0

_SAME_FPS: Final = 0.01  # 29.97 is what some call 30


class Capture(Protocol):
    """An open source. Thread: the reading thread's alone."""

    period_s: float | None
    """Real seconds from picture to picture, where the source does not keep time by itself."""

    def read(self) -> Image:
        """Return the next picture, in an array that is never written again.

        Raises:
            EOFError: there is none after the last.
            OSError: it is lost.

        Thread: blocks the caller until the source delivers.
        """
        ...

    def mode(self) -> dict[str, float]:
        """Return what it says of its width, height, fps and exposure; a key is left out where it says nothing."""
        ...

    def adjust(self, wishes: Mapping[str, float]) -> list[str]:
        """Ask for some of width, height, fps and exposure; return what was refused, and what there is instead."""
        ...

    def release(self) -> None:
        """Let go of the source."""
        ...


def real_s() -> float:
    """Return OpenCV's steady clock: a camera lives in real time, whatever the fleet's clock does."""
    return float(cv2.getTickCount() / cv2.getTickFrequency())


def is_same_fps(one: float, other: float) -> bool:
    """Tell whether two frame rates are the same but for rounding."""
    return abs(one - other) <= _SAME_FPS * max(one, other)


def fps_of(capture: Any) -> dict[str, float]:
    """Return what a VideoCapture says of its frame rate, if that makes sense, under `fps`."""
    fps = float(capture.get(cv2.CAP_PROP_FPS))
    return {"fps": fps} if LEAST_FPS <= fps <= MOST_FPS else {}


def refuse_all(what: str, has: Mapping[str, float | None], wishes: Mapping[str, float]) -> list[str]:
    """Refuse every wish that is not what there is already.

    Args:
        what: the kind of source, for messages.
        has: what there is; None where it has no such thing.
        wishes: what is wanted.
    """
    refused = []
    for key, wish in wishes.items():
        found = has.get(key)
        if found is None:
            refused.append(f"{key}: a {what} has none that could be set")
        elif not (is_same_fps(wish, found) if key == "fps" else wish == found):
            refused.append(f"{key}: a {what} has its own, {found:g}, and cannot have {wish:g}")
    return refused
