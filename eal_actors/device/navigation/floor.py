"""The floor of a fleet: the grid on which its paths are planned."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from eal_actors.device.navigation.grid import OccupancyGrid
from eal_actors.device.navigation.map_file import load_map
from eal_actors.device.navigation.world_grid import close_zones, grid_from_world
from eal_actors.device.world import WorldModel

WALL_MARGIN_M: Final = 0.05
"""Distance that a robot's hull keeps from obstacles on a path that is planned for it alone."""


def floor_grid(
    world: WorldModel | None, map_path: Path | None, zones: Sequence[Sequence[tuple[float, float]]] = ()
) -> OccupancyGrid | None:
    """Return the cells of the map file or, without one, of the world; None for an open floor.

    The keep-out zones of the world are closed in both, and so are further `zones`, given by their corners in metres.

    Raises:
        ConfigError: the map file is not right.
        UnsupportedError: Pillow is not installed.
    """
    if map_path is not None:
        grid, zones = load_map(map_path), (*(world.keep_out if world is not None else ()), *zones)
    elif world is not None:
        grid = grid_from_world(world)
    else:
        return None
    return close_zones(grid, zones) if zones else grid
