"""The brightness of the surfaces of a room."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eal_actors.device.world import WorldModel

from .eye import Floats

_MEAN_GAIN: Final = 0.93
_SPAN: Final = 1.5  # photographs have more contrast than illuminance
_BRIGHTEST: Final = 1.2  # an asymptote: film saturates gradually
_AMBIENT_SIDEWAYS, _AMBIENT_UP = 0.86, 0.14  # less of it comes from below
_NEAREST_M2: Final = 0.01
_PROBES_PER_SIDE: Final = 12

SIDES: Final = 12
"""Number of compass directions in which the light on moving objects is computed."""

_TURNS: Final = np.arange(SIDES + 1) * (2 * math.pi / SIDES) - math.pi
_DIRECTIONS: Final = np.array([*((math.cos(turn), math.sin(turn), 0.0) for turn in _TURNS.tolist()), (0.0, 0.0, 1.0)])


class RoomLight:
    """The lamps and the ambient light of a world, as factors on the colours of surfaces.

    The exposure makes the floor and the walls, on average, a little darker than their colours.
    """

    def __init__(self, model: WorldModel) -> None:
        self._ambient_lux = model.lighting.ambient_lux
        self.lamps: Final = tuple(model.lighting.lamps)
        self._lamps_m = np.array([[lamp.x_m, lamp.y_m, lamp.z_m] for lamp in self.lamps]).reshape(-1, 3)
        self._candela = np.array([lamp.lumens / (4 * math.pi) for lamp in self.lamps])
        self._ambient_around = self._ambient_lux * (_AMBIENT_SIDEWAYS + _AMBIENT_UP * _DIRECTIONS[:, 2])
        self._height_m = model.height_m
        self._mean_lux = 1.0
        self._mean_lux = max(float(np.mean(self._probe(*model.size_m))), 1e-6)

    def lux(self, points: Floats, normals: Floats) -> NDArray[np.float64]:
        """Return the light on surfaces, (n,).

        Args:
            points: in the world's frame, (n, 3), in metres.
            normals: unit vectors out of the surfaces, (n, 3) or (3,).
        """
        up = normals[..., 2]
        total = self._ambient_lux * (_AMBIENT_SIDEWAYS + _AMBIENT_UP * up) * np.ones(len(points))
        if len(self._lamps_m):
            away = self._lamps_m - points[:, np.newaxis]
            towards = np.maximum((away * normals.reshape(-1, 1, 3)).sum(axis=2), 0.0)
            total += (towards / _cubes_m3(away)) @ self._candela
        return np.asarray(total)

    def gain(self, points: Floats, normals: Floats) -> NDArray[np.float64]:
        """Return the factors on colours, (n,); arguments as for `lux`."""
        return self.factor(self.lux(points, normals))

    def around(self, places: Floats) -> NDArray[np.float64]:
        """Return the factors on upright and level surfaces at some places.

        Args:
            places: in the world's frame, (n, 3), in metres.

        Returns:
            (n, SIDES + 2): facing against x, counter-clockwise in equal steps for a full turn, then facing up.
        """
        away = self._lamps_m - places[:, np.newaxis]
        towards = np.maximum(away @ _DIRECTIONS.T, 0.0)
        candela_m3 = self._candela / _cubes_m3(away)
        return self.factor(self._ambient_around + (candela_m3[:, np.newaxis] @ towards)[:, 0])

    def factor(self, lux: Floats) -> NDArray[np.float64]:
        """Return the factors on colours for an illuminance."""
        gain = _MEAN_GAIN * (np.asarray(lux) / self._mean_lux) ** _SPAN
        return np.asarray(gain / (1 + (gain / _BRIGHTEST) ** 4) ** 0.25)

    def _probe(self, length_m: float, width_m: float) -> NDArray[np.float64]:
        steps = (np.arange(_PROBES_PER_SIDE) + 0.5) / _PROBES_PER_SIDE
        across, along = (grid.ravel() for grid in np.meshgrid(steps - 0.5, steps))
        floor = np.stack([across * length_m, (along - 0.5) * width_m, np.zeros_like(across)], axis=1)
        wall = np.stack([across * length_m, np.full_like(across, width_m / 2), along * self._height_m], axis=1)
        return np.concatenate([self.lux(floor, np.array([0.0, 0.0, 1.0])), self.lux(wall, np.array([0.0, -1.0, 0.0]))])


def _cubes_m3(away: Floats) -> NDArray[np.float64]:
    """Return the cubes of the lengths of vectors, (..., 3), in metres; none is shorter than a bound."""
    return np.asarray(np.maximum((away**2).sum(axis=-1), _NEAREST_M2) ** 1.5)
