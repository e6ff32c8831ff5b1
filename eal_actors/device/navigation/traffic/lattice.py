"""Lattice: places on the floor at equal distances, and the ways between neighbours."""

from __future__ import annotations

from typing import Final, TypeAlias

import numpy as np

from eal_actors.device.localization.pose_estimate import Point
from eal_actors.device.navigation.grid import OccupancyGrid
from eal_actors.device.navigation.traffic.errors import TrafficError

Edge: TypeAlias = tuple[int, int]

MAX_PLACES: Final = 20_000
_OFFSETS: Final = 6
"""The lattice is tried at so many offsets along each axis, and put where most of its places are free."""


def lay_lattice(inflated: OccupancyGrid, pitch_m: float) -> tuple[list[Point], list[Edge]]:
    """Return the free places at a pitch, and the free ways between neighbours, for the centre of the largest robot.

    Raises TrafficError if there would be too many places.
    """
    low, high = inflated.corners.min(axis=0), inflated.corners.max(axis=0)
    counts = np.floor((high - low) / pitch_m).astype(int) + 1
    if counts.prod() > MAX_PLACES:
        raise TrafficError(
            f"the map is too large to plan on: {counts.prod():,} places {pitch_m:.2f} m apart, at most {MAX_PLACES:,}; "
            "drive each robot by base.go_to or base.follow"
        )
    steps = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 2)
    shifts = [low + pitch_m * np.array(step) / _OFFSETS for step in np.ndindex(_OFFSETS, _OFFSETS)]
    layouts = [(inflated.are_free(shift + pitch_m * steps), shift) for shift in shifts]
    free, (east_m, north_m) = max(layouts, key=lambda layout: int(layout[0].sum()))
    points: list[Point] = []
    number_of: dict[tuple[int, int], int] = {}
    for (column, row), is_free in zip(steps.tolist(), free.tolist(), strict=True):
        if is_free:
            number_of[column, row] = len(points)
            points.append((float(east_m) + pitch_m * column, float(north_m) + pitch_m * row))
    edges = [
        (here, there)
        for (column, row), here in number_of.items()
        for beside in ((column + 1, row), (column, row + 1))
        if (there := number_of.get(beside)) is not None and inflated.is_line_free(points[here], points[there])
    ]
    return points, edges
