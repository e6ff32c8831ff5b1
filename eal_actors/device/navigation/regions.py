"""Regions: parts of the free floor that are connected. Whether a way exists is known without a search.

Each row is cut into runs of free cells. Runs that touch in neighbouring rows are one region (union-find). So the work
grows with the number of runs, not of cells; libraries that do the same, such as OpenCV, are no dependency of maps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def label_regions(blocked: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return the region of each cell by its four neighbours, in the shape of the mask: 1 and more, 0 if blocked."""
    rows, columns = blocked.shape
    framed = np.zeros((rows, columns + 2), np.int8)
    framed[:, 1:-1] = ~blocked
    steps = np.diff(framed, axis=1)
    row_of, starts = np.nonzero(steps == 1)
    ends = np.nonzero(steps == -1)[1]
    parents = list(range(len(starts)))

    def root(run: int) -> int:
        while parents[run] != run:
            parents[run] = run = parents[parents[run]]
        return run

    for above, below in _touching(row_of, starts, ends).tolist():
        first, last = root(above), root(below)
        parents[max(first, last)] = min(first, last)
    names = np.array([root(run) for run in range(len(starts))], np.int32)
    numbers = np.unique(names, return_inverse=True)[1].astype(np.int32) + 1
    changes = np.zeros((rows, columns + 1), np.int32)
    changes[row_of, starts], changes[row_of, ends] = numbers, changes[row_of, ends] - numbers
    return np.cumsum(changes[:, :-1], axis=1, dtype=np.int32)


def _touching(row_of: NDArray[np.intp], starts: NDArray[np.intp], ends: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the pairs of runs that share a column in neighbouring rows, shape (n, 2).

    Runs are in order of their rows and columns, so those in the next row that a run touches follow each other.
    """
    width = int(ends.max(initial=0)) + 1
    firsts = np.searchsorted(row_of * width + ends, (row_of + 1) * width + starts, side="right")
    lasts = np.searchsorted(row_of * width + starts, (row_of + 1) * width + ends, side="left")
    counts = np.maximum(lasts - firsts, 0)
    above = np.repeat(np.arange(len(starts)), counts)
    offsets = np.arange(len(above)) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.stack((above, np.repeat(firsts, counts) + offsets), axis=1)
