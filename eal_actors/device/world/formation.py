"""Formations: start poses of many robots by one rule."""

from __future__ import annotations

import math
from typing import Final, Literal

from pydantic import Field, PositiveFloat

from eal_actors.device.world.parts import Degrees, FloorItem, StartPose

MAX_PLACES: Final = 10_000


class Formation(FloorItem):
    """Start poses of many robots by a rule; see `formation_poses` for each shape."""

    shape: Literal["line", "column", "grid", "circle", "wedge"]
    count: int = Field(ge=1, le=MAX_PLACES)
    """Number of places."""
    spacing_m: PositiveFloat
    """Distance between neighbours."""
    x_m: float = 0.0
    """Centre of the formation: the mean of its places."""
    y_m: float = 0.0
    """Centre of the formation: the mean of its places."""
    yaw_deg: Degrees = 0.0
    """Heading of the formation and of each robot in it; in a circle they face outwards, the first this way."""


def formation_poses(formation: Formation) -> tuple[StartPose, ...]:
    """Return the start poses of a formation, rounded to the micrometre.

    A `line` is abreast, the first on the left; a `column` is one behind the other, the first in front; a `grid` has
    as many rows as columns or one less, the first robot at the front left; a `circle` goes counter-clockwise from the
    way the formation faces; a `wedge` is a V whose point is the first robot, then left and right by turns.
    """
    places = _SHAPES[formation.shape](formation.count, formation.spacing_m)
    middle_x, middle_y = (sum(place[axis] for place in places) / len(places) for axis in range(2))
    yaw_rad = math.radians(formation.yaw_deg)
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    poses = []
    for ahead, left, turn_deg in places:
        ahead, left = ahead - middle_x, left - middle_y
        poses.append(
            StartPose(
                x_m=round(formation.x_m + cos * ahead - sin * left, 6),
                y_m=round(formation.y_m + sin * ahead + cos * left, 6),
                yaw_deg=round(math.remainder(formation.yaw_deg + turn_deg, 360.0), 6),
            )
        )
    return tuple(poses)


_Places = list[tuple[float, float, float]]  # metres ahead, metres to the left, degrees turned to the left


def _line(count: int, spacing_m: float) -> _Places:
    return [(0.0, -number * spacing_m, 0.0) for number in range(count)]


def _column(count: int, spacing_m: float) -> _Places:
    return [(-number * spacing_m, 0.0, 0.0) for number in range(count)]


def _grid(count: int, spacing_m: float) -> _Places:
    columns = math.ceil(math.sqrt(count))
    return [(-(number // columns) * spacing_m, -(number % columns) * spacing_m, 0.0) for number in range(count)]


def _circle(count: int, spacing_m: float) -> _Places:
    radius_m = spacing_m / (2 * math.sin(math.pi / count)) if count > 1 else 0.0
    turns = [2 * math.pi * number / count for number in range(count)]
    return [(radius_m * math.cos(turn), radius_m * math.sin(turn), math.degrees(turn)) for turn in turns]


def _wedge(count: int, spacing_m: float) -> _Places:
    step_m = spacing_m / math.sqrt(2)
    ranks = [(number + 1) // 2 for number in range(count)]
    return [(-rank * step_m, rank * step_m * (1 if number % 2 else -1), 0.0) for number, rank in enumerate(ranks)]


_SHAPES = {"line": _line, "column": _column, "grid": _grid, "circle": _circle, "wedge": _wedge}
