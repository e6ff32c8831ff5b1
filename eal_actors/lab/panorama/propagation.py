"""Loopy belief propagation on a grid that closes to a ring: the labels of least cost, alike between neighbours.

Min-sum messages in sweeps over columns and rows, with a truncated linear cost of a difference of labels (Source:
Felzenszwalb and Huttenlocher, "Efficient belief propagation for early vision", 2006). Sweeps carry a belief across
cells that have no opinion in one pass, where parallel updates would need as many passes as there are cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eal_actors.lab.panorama.cylinder import Floats

_SWEEPS: Final = 4
_SMOOTHINGS: Final = 60


@dataclass(frozen=True, slots=True, eq=False)
class Coupling:
    """Costs of different labels in neighbouring cells.

    Attributes:
        across: factor between each cell and the next of its row, round the ring, (rows, columns).
        along: factor between each cell and the one below it, (rows - 1, columns).
        most: largest difference of labels that counts.
        rising: further factor if the label of the upper cell is the larger one.
    """

    across: Floats
    along: Floats
    most: float
    rising: float


def propagate(costs: Floats, coupling: Coupling) -> NDArray[np.int64]:
    """Return the label of each cell, (rows, columns).

    The costs are those of each label in each cell, (rows, columns, labels), and those of differences.
    """
    rows, columns, labels = costs.shape
    up = np.arange(labels)[:, np.newaxis] - np.arange(labels)  # of the receiver above the sender
    level = np.minimum(np.abs(up), coupling.most).astype(np.float32)
    downwards = level * np.where(up < 0, coupling.rising, 1).astype(np.float32)
    upwards = downwards.T
    to_right, to_left, to_below, to_above = (np.zeros_like(costs) for _ in range(4))
    for _ in range(_SWEEPS):
        for column in range(columns):
            after = (column + 1) % columns
            sent = costs[:, column] + to_right[:, column] + to_below[:, column] + to_above[:, column]
            to_right[:, after] = _message(sent, coupling.across[:, column], level)
        for column in reversed(range(columns)):
            sent = costs[:, column] + to_left[:, column] + to_below[:, column] + to_above[:, column]
            to_left[:, column - 1] = _message(sent, coupling.across[:, column - 1], level)
        for row in range(rows - 1):
            sent = costs[row] + to_right[row] + to_left[row] + to_below[row]
            to_below[row + 1] = _message(sent, coupling.along[row], downwards)
        for row in reversed(range(1, rows)):
            sent = costs[row] + to_right[row] + to_left[row] + to_above[row]
            to_above[row - 1] = _message(sent, coupling.along[row - 1], upwards)
    return np.asarray((costs + to_right + to_left + to_below + to_above).argmin(axis=2))


def _message(sent: Floats, factors: Floats, differences: Floats) -> Floats:
    """Return the least cost of each label of the receivers, (n, labels)."""
    sent = sent - sent.min(axis=1, keepdims=True)
    return np.asarray((sent[:, np.newaxis] + factors[:, np.newaxis, np.newaxis] * differences).min(axis=2))


def smoothed(labels: NDArray[np.int64]) -> Floats:
    """Return the smoothest values within half a label of the given ones; a step of more than one label stays.

    `labels` is (rows, columns); the columns close to a ring.
    """
    values = labels.astype(np.float32)
    least, most = values - 0.5, values + 0.5
    right = (np.abs(np.roll(labels, -1, 1) - labels) <= 1).astype(np.float32)
    left = np.roll(right, 1, 1)
    below = np.pad((np.abs(labels[1:] - labels[:-1]) <= 1).astype(np.float32), ((0, 1), (0, 0)))
    above = np.roll(below, 1, 0)
    number = np.maximum(right + left + below + above, 1)
    for _ in range(_SMOOTHINGS):
        sums = right * np.roll(values, -1, 1) + left * np.roll(values, 1, 1)
        sums += below * np.roll(values, -1, 0) + above * np.roll(values, 1, 0)
        values = np.clip(sums / number, least, most)
    return values
