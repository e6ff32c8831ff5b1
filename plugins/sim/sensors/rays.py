"""Range rays: how far it is from a robot's centre to whatever stands in the way.

The rays of a hundred robots together cost little more than those of one. So robots that read at a steady rate are
foreseen: when one asks, the rays of all that are due by then are cast with its own, and wait for their asking. What a
robot is told does not depend on who was cast together.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from ..robot import SimRobot
from ..world import SimWorld
from .geometry import Array, rectangle_span_m
from .scene import Scene
from .shared import shared

if TYPE_CHECKING:
    from numpy.typing import NDArray

RAYS: Final = 16
MAX_RANGE_M: Final = 4.0
_PITCH_RAD: Final = 2 * math.pi / RAYS
RAY_ANGLES_RAD: Final = np.arange(RAYS, dtype=np.float64) * _PITCH_RAD

_Indices: TypeAlias = "NDArray[np.intp]"
_COS: Final = np.cos(RAY_ANGLES_RAD)
_SIN: Final = np.sin(RAY_ANGLES_RAD)
_UPRIGHT: Final = (np.array(1.0), np.array(0.0))
_MARGIN: Final = 1e-6  # of a ray's pitch: rather a ray too many is tried than one too few
_EARLY_S: Final = 1e-6  # times are counted in ticks, so that this is only rounding


def ranges_m(world: SimWorld, robot: SimRobot, now_s: float) -> Array:
    """Return the distance from the robot's centre to what each ray meets, MAX_RANGE_M where it meets nothing.

    Args:
        world: the robot's world.
        robot: whose rays they are; they miss itself.
        now_s: the world's time.

    Returns:
        Shape (RAYS,), not to be changed.

    Raises:
        UnavailableError: the robot has no place in the world.

    Thread: inside `caught_up`.
    """
    return shared(world, RayCaster).ranges_m(world, robot, now_s)


class RayCaster:
    """Casts the rays of all robots of one world. Thread: inside `caught_up`."""

    def __init__(self) -> None:
        self._scene: Scene | None = None
        self._found_m: dict[str, Array] = {}
        self._found_in = 0
        self._asked_s: dict[str, float] = {}
        self._due_s: dict[str, float] = {}

    def ranges_m(self, world: SimWorld, robot: SimRobot, now_s: float) -> Array:
        """See the function of this name."""
        scene = self._scene = self._scene or shared(world, Scene)
        scene.follow(world, now_s)
        if scene.version != self._found_in:
            self._found_in = scene.version
            self._found_m.clear()
        if robot.name not in self._found_m:
            names = [robot.name, *self._pop_due(robot.name, now_s)]
            self._found_m.update(zip(names, cast(scene, [scene.row_of(name) for name in names]), strict=True))
        self._foresee(robot.name, now_s)
        return self._found_m[robot.name]

    def _pop_due(self, but: str, now_s: float) -> list[str]:
        due = [name for name, due_s in self._due_s.items() if due_s <= now_s + _EARLY_S and name != but]
        for name in due:
            del self._due_s[name]  # one that has ceased to ask is cast once more at most
        return due

    def _foresee(self, name: str, now_s: float) -> None:
        asked_s = self._asked_s.get(name, now_s)
        if asked_s < now_s:
            self._due_s[name] = now_s + (now_s - asked_s)
        self._asked_s[name] = now_s


def cast(scene: Scene, rows: list[int]) -> Array:
    """Return the ranges of some of the scene's robots, shape (len(rows), RAYS)."""
    of = np.array(rows)[:, np.newaxis]
    x_m, y_m, cos, sin = scene.x_m[of], scene.y_m[of], scene.cos[of], scene.sin[of]
    ux, uy = _COS * cos - _SIN * sin, _COS * sin + _SIN * cos
    _, walls_m = rectangle_span_m(-x_m, -y_m, ux, uy, *_UPRIGHT, *scene.half_room_m)
    found_m = np.minimum(walls_m, MAX_RANGE_M).ravel()
    dx, dy = scene.x_m - x_m, scene.y_m - y_m
    distance_m = np.sqrt(dx * dx + dy * dy)
    distance_m[np.arange(len(rows)), rows] = np.inf  # rays miss their own robot
    caster, body = np.nonzero(distance_m < MAX_RANGE_M + scene.radius_m)
    dx, dy = dx[caster, body], dy[caster, body]
    bearing_rad = np.arctan2(dy, dx) - scene.yaw_rad[of[caster, 0]]
    near, ray = _aimed_rays(bearing_rad, distance_m[caster, body], scene.radius_m[body])
    cell, body = caster[near] * RAYS + ray, body[near]
    lines = dx[near], dy[near], ux.ravel()[cell], uy.ravel()[cell]
    is_disc = body < scene.first_rectangle
    for chosen, span_m in ((is_disc, scene.disc_span_m), (~is_disc, scene.rectangle_span_m)):
        enter_m, leave_m = span_m(body[chosen], *(part[chosen] for part in lines))
        met_m = np.where((enter_m <= leave_m) & (enter_m >= 0.0), enter_m, MAX_RANGE_M)
        np.minimum.at(found_m, cell[chosen], met_m)
    return found_m.reshape(len(rows), RAYS)


def _aimed_rays(bearing_rad: Array, distance_m: Array, radius_m: Array) -> tuple[_Indices, _Indices]:
    """Return which rays may meet which circles: equally long indices of circles and numbers of rays."""
    half_width_rad = np.where(distance_m > radius_m, np.arcsin(radius_m / np.maximum(distance_m, radius_m)), np.pi)
    first = np.ceil((bearing_rad - half_width_rad) / _PITCH_RAD - _MARGIN).astype(np.intp)
    last = np.floor((bearing_rad + half_width_rad) / _PITCH_RAD + _MARGIN).astype(np.intp)
    counts = np.minimum(last - first + 1, RAYS)
    circle = np.repeat(np.arange(counts.size), counts)
    place = np.arange(circle.size) - np.repeat(np.cumsum(counts) - counts, counts)
    return circle, (first[circle] + place) % RAYS
