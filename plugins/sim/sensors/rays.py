"""Range rays: the distances from a robot's centre to the nearest objects.

The rays of a hundred robots together cost little more than those of one. So robots that read at a steady rate are
predicted: a reading also casts the rays of all robots that are due by then, and caches them. A robot's ranges do not
depend on which robots are cast together.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from ..robot import SimRobot
from ..world import SimWorld
from .arrays import WorldArrays, shared
from .geometry import Array

if TYPE_CHECKING:
    from numpy.typing import NDArray

RAYS: Final = 16
MAX_RANGE_M: Final = 4.0
_PITCH_RAD: Final = 2 * math.pi / RAYS
RAY_ANGLES_RAD: Final = np.arange(RAYS, dtype=np.float64) * _PITCH_RAD

_Indices: TypeAlias = "NDArray[np.intp]"
_COS: Final = np.cos(RAY_ANGLES_RAD)
_SIN: Final = np.sin(RAY_ANGLES_RAD)
_MARGIN: Final = 1e-6  # of a ray's pitch: rounding must not skip a ray
_EARLY_S: Final = 1e-6  # times are counted in ticks, so that this is only rounding


def ranges_m(world: SimWorld, robot: SimRobot, now_s: float) -> Array:
    """Return the distance from the robot's centre to the first hit of each ray, MAX_RANGE_M for no hit.

    Its rays ignore its own disc.

    Returns:
        Shape (RAYS,); read-only.

    Raises:
        UnavailableError: the robot has no place in the world.

    Thread: holds the world's `lock`.
    """
    return shared(world, RayCaster).ranges_m(world, robot, now_s)


def free_way_m(world: SimWorld, robot: SimRobot, now_s: float, *, forward: bool) -> float:
    """Return the free distance from the robot's outline along its way, by its rays; infinity if they see nothing there.

    Raises:
        UnavailableError: the robot has no place in the world.

    Thread: holds the world's `lock`.
    """
    found_m, radius_m = ranges_m(world, robot, now_s), robot.make.radius_m
    ahead_m = found_m * _COS if forward else -found_m * _COS
    beside_m = np.abs(found_m * _SIN)
    in_way = (found_m < MAX_RANGE_M) & (ahead_m > 0.0) & (beside_m < radius_m)
    if not in_way.any():
        return math.inf
    gaps_m = ahead_m[in_way] - np.sqrt(radius_m * radius_m - beside_m[in_way] ** 2)
    return max(float(gaps_m.min()), 0.0)


class RayCaster:
    """Casts the rays of all robots of one world. Thread: holds the world's `lock`."""

    def __init__(self) -> None:
        self._arrays: WorldArrays | None = None
        self._found_m: dict[str, Array] = {}
        self._found_in = -1
        self._asked_s: dict[str, float] = {}
        self._due_s: dict[str, float] = {}

    def ranges_m(self, world: SimWorld, robot: SimRobot, now_s: float) -> Array:
        """Return the ranges of a robot; see the function `ranges_m`."""
        arrays = self._arrays = self._arrays or shared(world, WorldArrays)
        arrays.update(world)
        if arrays.version != self._found_in:
            self._found_in = arrays.version
            self._found_m.clear()
        if robot.name not in self._found_m:
            names = [robot.name, *self._pop_due(robot.name, now_s)]
            self._found_m.update(zip(names, cast(arrays, [arrays.column_of(name) for name in names]), strict=True))
        self._predict(robot.name, now_s)
        return self._found_m[robot.name]

    def _pop_due(self, but: str, now_s: float) -> list[str]:
        due = [name for name, due_s in self._due_s.items() if due_s <= now_s + _EARLY_S and name != but]
        for name in due:
            del self._due_s[name]  # a robot that stopped reading is cast at most once more
        return due

    def _predict(self, name: str, now_s: float) -> None:
        asked_s = self._asked_s.get(name, now_s)
        if asked_s < now_s:
            self._due_s[name] = now_s + (now_s - asked_s)
        self._asked_s[name] = now_s


def cast(arrays: WorldArrays, rows: list[int]) -> Array:
    """Return the ranges of some robots, shape (len(rows), RAYS)."""
    of = np.array(rows)[:, np.newaxis]
    x_m, y_m, cos, sin = arrays.x_m[of], arrays.y_m[of], arrays.cos[of], arrays.sin[of]
    ux, uy = _COS * cos - _SIN * sin, _COS * sin + _SIN * cos
    found_m = np.minimum(arrays.to_walls_m(x_m, y_m, ux, uy), MAX_RANGE_M).ravel()
    dx, dy = arrays.x_m - x_m, arrays.y_m - y_m
    distance_m = np.sqrt(dx * dx + dy * dy)
    distance_m[np.arange(len(rows)), rows] = np.inf  # rays ignore their own robot
    caster, body = np.nonzero(distance_m < MAX_RANGE_M + arrays.radius_m)
    dx, dy = dx[caster, body], dy[caster, body]
    bearing_rad = np.arctan2(dy, dx) - arrays.yaw_rad[of[caster, 0]]
    near, ray = _aimed_rays(bearing_rad, distance_m[caster, body], arrays.radius_m[body])
    cell, body = caster[near] * RAYS + ray, body[near]
    lines = dx[near], dy[near], ux.ravel()[cell], uy.ravel()[cell]
    is_disc = body < arrays.first_rectangle
    for chosen, span_m in ((is_disc, arrays.disc_span_m), (~is_disc, arrays.rectangle_span_m)):
        enter_m, leave_m = span_m(body[chosen], *(part[chosen] for part in lines))
        met_m = np.where((enter_m <= leave_m) & (enter_m >= 0.0), enter_m, MAX_RANGE_M)
        np.minimum.at(found_m, cell[chosen], met_m)
    return found_m.reshape(len(rows), RAYS)


def _aimed_rays(bearing_rad: Array, distance_m: Array, radius_m: Array) -> tuple[_Indices, _Indices]:
    """Return the candidate hits: equally long arrays of circle indices and ray numbers."""
    half_width_rad = np.where(distance_m > radius_m, np.arcsin(radius_m / np.maximum(distance_m, radius_m)), np.pi)
    first = np.ceil((bearing_rad - half_width_rad) / _PITCH_RAD - _MARGIN).astype(np.intp)
    last = np.floor((bearing_rad + half_width_rad) / _PITCH_RAD + _MARGIN).astype(np.intp)
    counts = np.minimum(last - first + 1, RAYS)
    circle = np.repeat(np.arange(counts.size), counts)
    place = np.arange(circle.size) - np.repeat(np.cumsum(counts) - counts, counts)
    return circle, (first[circle] + place) % RAYS
