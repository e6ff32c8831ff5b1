"""Maps of range scans: an ideal scanner in a room of known walls."""

from __future__ import annotations

import math

import numpy as np
import pytest

from eal_actors.device.navigation.grid import OccupancyGrid
from eal_actors.device.navigation.scan_map import ScanMap
from eal_actors.kernel.errors import ArgumentError

ANGLES = np.linspace(-math.pi, math.pi, 720, endpoint=False)


def room_scan(x_m: float, y_m: float, yaw_rad: float, half_m: float, reach_m: float) -> np.ndarray:
    """Return the distances to the walls of a square room about the origin."""
    cos, sin = np.cos(yaw_rad + ANGLES), np.sin(yaw_rad + ANGLES)
    with np.errstate(divide="ignore"):
        to_x = np.where(cos > 0, half_m - x_m, -half_m - x_m) / cos
        to_y = np.where(sin > 0, half_m - y_m, -half_m - y_m) / sin
    return np.minimum(np.minimum(to_x, to_y), reach_m)


def scanned(*poses: tuple[float, float, float], half_m: float = 2.02, reach_m: float = 8.0) -> OccupancyGrid:
    scan_map = ScanMap()
    for pose in poses:
        scan_map.add(pose, room_scan(*pose, half_m, reach_m), ANGLES, reach_m)
    return scan_map.grid()


def test_scans_show_the_walls_and_the_floor_before_them() -> None:
    grid = scanned((0.5, -0.3, 0.4), (-1, 1, 2.0), (0.2, 0.9, -3))
    inner = [(x, y) for x in np.arange(-1.9, 1.95, 0.1) for y in np.arange(-1.9, 1.95, 0.1)]
    assert grid.are_free(inner).all()
    walls = [(2.02, y) for y in np.arange(-1.8, 1.85, 0.1)] + [(x, -2.02) for x in np.arange(-1.8, 1.85, 0.1)]
    assert [grid.cells[grid.cell_at(x, y) or (0, 0)] >= 65 for x, y in walls].count(False) <= 1
    assert not grid.is_free(2.3, 0)


def test_what_no_ray_met_is_unknown_and_the_greatest_range_is_no_wall() -> None:
    grid = scanned((0, 0, 0), reach_m=1.0)
    assert grid.is_free(0.9, 0)
    assert not (grid.cells >= 65).any()
    assert (grid.cells == -1).any()


def test_a_thing_that_went_away_is_forgotten() -> None:
    scan_map = ScanMap()
    for _ in range(10):
        scan_map.add((0, 0, 0), np.full(720, 1.0), ANGLES, 5.0)
    assert not scan_map.grid().is_free(1.0, 0.0)
    for _ in range(15):
        scan_map.add((0, 0, 0), np.full(720, 3.0), ANGLES, 5.0)
    assert scan_map.grid().is_free(1.0, 0.0)


def test_a_map_grows_with_the_floor_it_has_seen() -> None:
    grid = scanned(*((x, 0.0, 0.0) for x in np.arange(-40, 40, 0.9)), half_m=1e6, reach_m=1.0)
    assert grid.is_free(-40, 0)
    assert grid.is_free(39, 0.5)
    assert 79 < grid.cells.shape[1] * 0.05 < 83


def test_invalid_ranges_are_skipped_and_infinite_ones_meet_nothing() -> None:
    scan_map = ScanMap()
    scan_map.add((0, 0, 0), [math.nan, -1.0, math.inf, 1.0], [0.0, math.pi / 2, math.pi, -math.pi / 2], 2.0)
    grid = scan_map.grid()
    assert grid.is_free(-1.9, 0)
    assert not grid.is_free(0.5, 0)
    assert not grid.is_free(0, 0.5)
    assert grid.cells[grid.cell_at(0, -1.0) or (0, 0)] == 70


@pytest.mark.parametrize(
    ("pose", "ranges", "angles"),
    [((0, 0, 0), [1.0], [0.0, 1.0]), ((math.nan, 0, 0), [1.0], [0.0]), ((0, 0, 0), [[1.0]], [[0.0]])],
)
def test_a_scan_must_fit(pose: tuple[float, float, float], ranges: object, angles: object) -> None:
    with pytest.raises(ArgumentError, match="a scan needs a finite pose and an angle for each range"):
        ScanMap().add(pose, ranges, angles, 5.0)  # type: ignore[arg-type]


def test_a_pose_far_away_does_not_take_the_memory() -> None:
    scan_map = ScanMap()
    scan_map.add((0, 0, 0), [1.0], [0.0], 5.0)
    with pytest.raises(ArgumentError, match="is too large"):
        scan_map.add((1e6, 1e6, 0), [1.0], [0.0], 5.0)
    assert scan_map.grid().is_free(0.5, 0)


def test_a_map_without_a_scan_is_an_error() -> None:
    with pytest.raises(ArgumentError, match="has no scan yet"):
        ScanMap().grid()
    with pytest.raises(ArgumentError, match="must be over 0 m, not 0"):
        ScanMap(0)
