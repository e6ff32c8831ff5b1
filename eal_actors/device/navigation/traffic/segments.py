"""Distances between points and straight ways, for many at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def distances_to_ways_m(points: ArrayLike, heres: ArrayLike, theres: ArrayLike) -> Floats:
    """Return the distance of each point from a straight way; shapes (n, 2) in metres broadcast against each other.

    A way of no length is a point.
    """
    at, here = np.asarray(points, np.float64), np.asarray(heres, np.float64)
    along = np.asarray(theres, np.float64) - here
    square = np.maximum((along**2).sum(axis=-1), 1e-18)
    share = np.clip(((at - here) * along).sum(axis=-1) / square, 0.0, 1.0)
    off: Floats = at - here - share[..., None] * along
    return np.asarray(np.hypot(off[..., 0], off[..., 1]))
