"""The pose of a camera, from markers at known places on the floor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import cv2
import numpy as np

from .lens import Floats, Lens

LEAST_MARKERS: Final = 2
_MOST_SIGHTS: Final = 50
"""Pictures over which corners are averaged; newer ones then replace older ones."""
_MOVED_PX: Final = 4.0
"""Mean distance of the corners from their former places after which the camera counts as moved."""
_WRONG_PX: Final = 3.0
"""Distance of a floor marker from its place after which the marker counts as moved."""


@dataclass(frozen=True)
class Mounting:
    """The pose of a camera in the map frame.

    Attributes:
        turn: rotation from the map frame to the camera's, as a rotation vector, (3,).
        shift_m: the map's origin in the camera's frame, (3,).
        error_px: root mean square distance of the corners from their places.
        markers: the floor markers that it rests on.
        wrong: floor markers that are not at their places, and their distances in pixels.
    """

    turn: Floats
    shift_m: Floats
    error_px: float
    markers: tuple[int, ...]
    wrong: Mapping[int, float]

    @cached_property
    def rotation(self) -> Floats:
        """Rotation from the camera's frame to the map frame, (3, 3)."""
        matrix, _ = cv2.Rodrigues(self.turn)
        return np.asarray(matrix, np.float64).T

    @cached_property
    def centre_m(self) -> Floats:
        """The camera's place in the map frame, (3,)."""
        return np.asarray(-self.rotation @ self.shift_m.ravel())

    def on_planes(self, rays: Floats, heights_m: Floats) -> Floats:
        """Return where rays meet level planes, x and y, (n, 2); NaN for a ray that does not descend."""
        ways = np.column_stack([rays, np.ones(len(rays))]) @ self.rotation.T
        with np.errstate(divide="ignore", invalid="ignore"):
            lengths = np.where(ways[:, 2] < 0, (heights_m - self.centre_m[2]) / ways[:, 2], np.nan)
        return np.asarray(self.centre_m[:2] + ways[:, :2] * lengths[:, np.newaxis])


class MountingEstimator:
    """Finds the pose of a camera, and notices when it changes.

    Corners are averaged over pictures while the camera stands still, which reduces their noise.

    Args:
        places: corners of each floor marker in the map frame, (4, 3), by id.

    Attributes:
        mounting: the present pose; None before enough markers were seen.
        moves: how often the camera was moved.
    """

    def __init__(self, lens: Lens, places: Mapping[int, Floats]) -> None:
        self._lens = lens
        self._places = places
        self._means: dict[int, tuple[Floats, int]] = {}
        self.mounting: Mounting | None = None
        self.moves = 0

    def add(self, seen: Mapping[int, Floats]) -> None:
        """Add a picture: the corners of floor markers in it, (4, 2), by id."""
        seen = {number: corners for number, corners in seen.items() if number in self._places}
        if self._has_moved(seen):
            self._means.clear()
            self.moves += 1
        for number, corners in seen.items():
            mean, count = self._means.get(number, (corners, 0))
            count = min(count + 1, _MOST_SIGHTS)
            self._means[number] = mean + (corners - mean) / count, count
        if len(self._means) >= LEAST_MARKERS and seen:
            self.mounting = self._solve(dict.fromkeys(self._means))

    def _has_moved(self, seen: Mapping[int, Floats]) -> bool:
        """Return whether most of the markers have left their places in the picture."""
        known = [number for number in seen if number in self._means]
        away_px = [float(np.linalg.norm(seen[one] - self._means[one][0], axis=1).mean()) for one in known]
        return len(away_px) >= LEAST_MARKERS and float(np.median(away_px)) > _MOVED_PX

    def _solve(self, numbers: Mapping[int, None]) -> Mounting:
        """Return the pose by least squares, without markers that are not at their places."""
        wrong: dict[int, float] = {}
        used = list(numbers)
        while True:
            turn, shift_m = self._fit(used)
            away_px = {one: self._distances(one, turn, shift_m) for one in numbers}
            worst = max(used, key=lambda one: float(away_px[one].mean()))
            worst_px = float(away_px[worst].mean())
            if worst_px <= _WRONG_PX or len(used) <= LEAST_MARKERS:
                break
            used.remove(worst)
        wrong = {one: float(away_px[one].mean()) for one in numbers if one not in used}
        error_px = float(np.sqrt(np.mean([away_px[one] ** 2 for one in used])))
        return Mounting(turn, shift_m, error_px, tuple(sorted(used)), wrong)

    def _fit(self, numbers: list[int]) -> tuple[Floats, Floats]:
        points = np.concatenate([self._places[one] for one in numbers])
        rays = self._lens.rays(np.concatenate([self._means[one][0] for one in numbers]))
        pixels = rays[:, np.newaxis]
        _, turn, shift_m = cv2.solvePnP(points, pixels, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
        turn, shift_m = cv2.solvePnPRefineLM(points, pixels, np.eye(3), None, turn, shift_m)
        return np.asarray(turn, np.float64), np.asarray(shift_m, np.float64)

    def _distances(self, number: int, turn: Floats, shift_m: Floats) -> Floats:
        places = self._lens.pixels(self._places[number], turn, shift_m)
        return np.asarray(np.linalg.norm(places - self._means[number][0], axis=1))
