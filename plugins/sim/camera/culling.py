"""What is left out at once, because it cannot be in the image."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .eye import Eye
from .movers import Mover
from .solids import Face

_MOST_REACH_M = 1.0  # of what moves, with its shadow


class Faces:
    """Faces that do not move.

    Args:
        groups: the faces of each thing.
    """

    def __init__(self, groups: Sequence[Sequence[Face]]) -> None:
        faces = [face for group in groups for face in group]
        self._faces = [(number, face) for number, group in enumerate(groups) for face in group]
        self._groups = len(groups)
        self._left, self._right = (np.array([getattr(face, end) for face in faces]) for end in ("left", "right"))
        self._normal = np.array([face.normal for face in faces])

    def in_view(self, eye: Eye) -> list[list[Face]]:
        """Return, of each group, those that show their front to a camera and are not beside or behind its image."""
        left, right = self._left - (eye.x_m, eye.y_m), self._right - (eye.x_m, eye.y_m)
        shown = (left * self._normal).sum(axis=1) < 0
        slope = eye.lens.width / 2 / eye.focal_px
        for side in (-1, 1):
            beyond = [side * right - slope * ahead for right, ahead in zip(eye.right, eye.ahead, strict=True)]
            shown &= np.minimum(left @ beyond, right @ beyond) < 0
        groups: list[list[Face]] = [[] for _ in range(self._groups)]
        for at in np.flatnonzero(shown).tolist():
            number, face = self._faces[at]
            groups[number].append(face)
        return groups


def may_be_seen(eye: Eye, mover: Mover) -> bool:
    """Return whether a robot or box may be in the image."""
    right_m, ahead_m = eye.seen((mover.x_m, mover.y_m))
    slope = eye.lens.width / 2 / eye.focal_px
    return abs(right_m) - ahead_m * slope < _MOST_REACH_M * math.hypot(1, slope)
