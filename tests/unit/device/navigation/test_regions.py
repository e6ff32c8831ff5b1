from __future__ import annotations

import cv2
import numpy as np
import pytest

from eal_actors.device.navigation.grid import FREE, INFLATED, OCCUPIED, GridOrigin, OccupancyGrid
from eal_actors.device.navigation.planner import plan_path
from eal_actors.device.navigation.regions import label_regions
from eal_actors.kernel.errors import NoPathError


@pytest.mark.parametrize("share", [0.0, 0.05, 0.3, 0.41, 0.6, 1.0])
def test_regions_are_those_of_opencv(share: float) -> None:
    for seed in range(8):
        generator = np.random.default_rng(seed)
        blocked = generator.random(generator.integers(1, 60, 2)) < share
        ours = label_regions(blocked)
        count, theirs = cv2.connectedComponents((~blocked).astype(np.uint8), connectivity=4)
        assert ((ours == 0) == blocked).all(), f"seed {seed}"
        pairs = np.unique(np.stack((ours[~blocked], theirs[~blocked])), axis=1).T
        assert len(pairs) == len(set(pairs[:, 0])) == len(set(pairs[:, 1])) == count - 1, f"seed {seed}"


@pytest.mark.parametrize("is_at_wall", [False, True])
def test_an_unreachable_goal_costs_no_search(is_at_wall: bool) -> None:
    """On 25 x 25 m, a closed room; a search would enter more than the cells that it may."""
    cells = np.full((500, 500), FREE, np.int8)
    cells[:, 300] = OCCUPIED
    if is_at_wall:
        cells[2, 2] = INFLATED
    grid = OccupancyGrid(cells, 0.05, GridOrigin(0.0, 0.0))
    with pytest.raises(NoPathError, match="obstacles separate them"):
        plan_path(grid, (0.12, 0.12), (24.0, 24.0), most_cells=1)
