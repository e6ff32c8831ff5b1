"""How bright each frame is beside its neighbours: cameras set their exposure anew for each frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from eal_actors.lab.panorama.cylinder import Floats, Patch
from eal_actors.lab.panorama.placing import Placing, overlap
from eal_actors.lab.panorama.shift import wrapped_rad

_DARKEST: Final = 4
_BRIGHTEST: Final = 250
"""Outside of these, a pixel no longer tells how bright the place is."""
_LEVELS_SIGMA: Final = 4.0
_GAIN_SIGMA: Final = 0.3
_FEWEST_PX: Final = 200


def gains_of(placing: Placing) -> dict[int, float]:
    """Return the factor on each placed frame that makes overlaps equally bright, by least squares; 1 on the average.

    Without overlaps that tell, a frame keeps its brightness.
    """
    numbers = sorted(placing.places)
    rows: list[Floats] = []
    targets: list[float] = []
    for at, one in enumerate(numbers):
        row = np.zeros(len(numbers))
        row[at] = 1 / _GAIN_SIGMA
        rows.append(row)
        targets.append(1 / _GAIN_SIGMA)
        for beyond, other in enumerate(numbers[at + 1 :], at + 1):
            levels = _mean_levels(placing.patches, placing.places, one, other)
            if levels is not None:
                row = np.zeros(len(numbers))
                row[at], row[beyond] = levels[0] / _LEVELS_SIGMA, -levels[1] / _LEVELS_SIGMA
                rows.append(row)
                targets.append(0.0)
    gains, *_ = np.linalg.lstsq(np.array(rows), np.array(targets), rcond=None)
    return dict(zip(numbers, (gains / gains.mean()).tolist(), strict=True))


def _mean_levels(
    patches: Mapping[int, Patch], places: Mapping[int, tuple[float, float]], one: int, other: int
) -> tuple[float, float] | None:
    """Return how bright both frames have what both show, in grey levels; None if that is too little."""
    first, second = patches[one], patches[other]
    right_px = round(wrapped_rad(places[one][0] - places[other][0]) * first.px_per_rad)
    if abs(right_px) >= first.grey.shape[1]:
        return None
    of_first, of_second, common = overlap(first, second, right_px)
    for colours in (of_first, of_second):
        common = common & (colours.min(axis=2) > _DARKEST) & (colours.max(axis=2) < _BRIGHTEST)
    if int(common.sum()) < _FEWEST_PX:
        return None
    return float(of_first[common].mean()), float(of_second[common].mean())
