"""A map file of map_server as the floor of a fleet, without a world."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from eal_actors.device.navigation.floor import floor_grid
from eal_actors.device.navigation.grid import FREE, OCCUPIED, GridOrigin, OccupancyGrid
from eal_actors.device.navigation.map_file import save_map
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ArgumentError, ConfigError

FLEET = """\
version: 1
name: mapped
seed: 3
clock: {rate: max}
map: floor.yaml
robots:
  rover: {plugins: {sim: {model: roomba, start: {x_m: -1, y_m: 0, yaw_deg: 0}}}}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A floor of 4 x 4 m, with a wall along y that leaves free what is above 1 m."""
    cells = np.full((80, 80), FREE, np.int8)
    cells[:60, 39:41] = OCCUPIED
    save_map(OccupancyGrid(cells, 0.05, GridOrigin(-2.0, -2.0)), tmp_path / "floor.yaml")
    (tmp_path / "fleet.yaml").write_text(FLEET)
    return tmp_path


def test_robots_drive_round_the_walls_of_the_map(folder: Path) -> None:
    with Fleet.load(folder / "fleet.yaml") as fleet:
        journey = fleet.go_to({"rover": (1.0, 0.0)})
        highest_m = 0.0
        while not journey.done():
            fleet.clock.sleep(0.5)
            highest_m = max(highest_m, fleet["rover"]["TruePose"].get_value().get().value[1])
        assert journey.get() == {"rover": 1}
        assert highest_m > 1.17
        with pytest.raises(ArgumentError, match=r"the goal of rover, .*is inside an obstacle"):
            fleet.go_to({"rover": (0.0, 0.0)}).get()


@pytest.mark.parametrize(
    ("change", "message"),
    [("floor.yaml", "no such file: .*gone.yaml"), ("resolution", "resolution"), ("floor.pgm", "floor.pgm")],
)
def test_a_map_that_is_not_right_is_named(folder: Path, change: str, message: str) -> None:
    if change == "floor.yaml":
        (folder / "fleet.yaml").write_text(FLEET.replace("floor.yaml", "gone.yaml"))
    elif change == "resolution":
        text = (folder / "floor.yaml").read_text()
        (folder / "floor.yaml").write_text(text.replace("resolution: 0.05", "resolution: -1"))
    else:
        (folder / "floor.pgm").unlink()
    with pytest.raises(ConfigError, match=message):
        Fleet.load(folder / "fleet.yaml")


def test_zones_close_cells_of_a_turned_map(folder: Path) -> None:
    grid = OccupancyGrid(np.full((80, 80), FREE, np.int8), 0.05, GridOrigin(0.0, -2.8, np.pi / 4))
    save_map(grid, folder / "turned.yaml")
    closed = floor_grid(None, folder / "turned.yaml", [((0.5, -0.5), (0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5))])
    assert closed is not None
    inside, outside = [(0.0, 0.0), (0.45, -0.45), (-0.45, 0.2)], [(0.6, 0.0), (0.0, -0.6), (-0.6, 0.55), (0.6, 0.6)]
    assert not closed.are_free(inside).any()
    assert closed.are_free(outside).all()
