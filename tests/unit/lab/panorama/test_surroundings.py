"""A camera beside the axis: its position by the floor, and the distances of what stands round it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from eal_actors.lab.panorama.alignment import align_pixels
from eal_actors.lab.panorama.cylinder import Attitude, CameraLens, wrapped_rad
from eal_actors.lab.panorama.depths import depth_map
from eal_actors.lab.panorama.parallax import KNOTS, USUAL_NEARNESS, DepthMap, Parallax, TurnedCamera
from eal_actors.lab.panorama.propagation import Coupling, propagate, smoothed
from eal_actors.lab.panorama.ring import ring_of
from tests.unit.lab.panorama.turning import PLACE_M, VIEW_RAD, noisy, shots_beside, steps, true_nearness

SHAPE = 5, 12
LABELS = 6


def coupling(across: float = 1.0, along: float = 1.0, most: float = 9.0, rising: float = 1.0) -> Coupling:
    rows, columns = SHAPE
    return Coupling(np.full(SHAPE, across), np.full((rows - 1, columns), along), most, rising)


def opinions(**cells: int) -> NDArray[np.float32]:
    """Return costs by which single cells, such as r2c3, want a label and the others want nothing."""
    costs = np.zeros((*SHAPE, LABELS), np.float32)
    for cell, label in cells.items():
        row, column = map(int, cell[1:].split("c"))
        costs[row, column] = 20
        costs[row, column, label] = 0
    return costs


def test_cells_without_an_opinion_take_that_of_the_others() -> None:
    assert (propagate(opinions(r2c3=4), coupling()) == 4).all()


def test_the_grid_closes_to_a_ring() -> None:
    weak = coupling(along=0.0)
    weak.across[:, [3, 8]] = 0.01
    labels = propagate(opinions(r0c11=5, r0c6=0), weak)[0]
    assert (labels[[9, 10, 11, 0, 1, 2, 3]] == 5).all()
    assert (labels[4:9] == 0).all()


def test_a_step_is_where_the_coupling_is_weak() -> None:
    weak = coupling(most=2.0)
    weak.across[:, [4, 9]] = 0.01
    labels = propagate(opinions(r2c6=5, r2c1=0), weak)
    assert (labels[:, 5:10] == 5).all()
    assert (labels[:, [*range(5), 10, 11]] == 0).all()


def test_what_stands_higher_up_is_seldom_nearer() -> None:
    weighed = coupling(along=3.0, most=3.0, rising=4.0)
    assert len(np.unique(propagate(opinions(r0c3=5, r4c3=0), weighed)[:, 3])) == 1, (
        "the step would cost 36, an opinion 20"
    )
    assert len(np.unique(propagate(opinions(r0c3=0, r4c3=5), weighed)[:, 3])) > 1, "the step costs 9"


def test_labels_of_a_slope_become_even_and_a_step_stays() -> None:
    labels = np.tile(np.repeat([1, 2, 3, 9, 9, 3, 2, 1], 4), (3, 1))
    values = smoothed(labels)
    assert np.abs(values - labels).max() <= 0.5
    assert 0 < np.diff(values[1, 1:11]).min() <= np.diff(values[1, 1:11]).max() < 0.5
    assert values[1, 12] - values[1, 11] > 5


def test_distances_are_interpolated_across_yaw_0() -> None:
    grid = np.arange(24, dtype=np.float32).reshape(2, 12)
    depths = DepthMap(grid, top=-0.2, row=0.2)
    yaws_rad = (np.arange(12) + 0.5) * math.tau / 12
    assert depths.at(yaws_rad, np.array([[-0.1], [0.1]])) == pytest.approx(grid, abs=1e-4)
    assert depths.at(np.array([0.0]), np.array([-0.1])) == pytest.approx(5.5, abs=1e-4)
    assert depths.at(yaws_rad[:1], np.array([[-9.0], [9.0]])).ravel() == pytest.approx([0, 12])


@pytest.mark.slow
@pytest.mark.parametrize(("ahead_m", "left_m"), [(0.08, 0.0), (0.0, 0.08)])
def test_the_floor_tells_position_and_turns_and_the_pixels_tell_distances(ahead_m: float, left_m: float) -> None:
    true_rad = noisy(steps(), seed=2)
    frames = dict(enumerate(shots_beside(true_rad, ahead_m, left_m, 640)))
    lens = CameraLens(640, 480, VIEW_RAD)
    rough_rad = noisy(true_rad, seed=9, sigma_deg=0.2)
    ahead, left = ahead_m / PLACE_M[2], left_m / PLACE_M[2]
    walls = np.full(KNOTS, USUAL_NEARNESS)
    rough = TurnedCamera(lens, Parallax(0.8 * ahead + 0.02, 0.8 * left - 0.02, walls))
    places = {number: Attitude(yaw_rad) for number, yaw_rad in enumerate(rough_rad)}
    ring = ring_of(dict(enumerate(rough_rad)), VIEW_RAD)

    camera, places = align_pixels(frames, rough, places, ring)
    assert (camera.parallax.ahead, camera.parallax.left) == pytest.approx((ahead, left), abs=0.01)
    off_rad = [wrapped_rad(places[number].yaw_rad - true_rad[number]) for number in frames]
    assert math.degrees(np.std(off_rad)) < 0.05

    depths = depth_map(frames, camera, places, ring)
    down = depths.top + (np.arange(len(depths.nearness)) + 0.5) * depths.row
    columns = depths.nearness.shape[1]
    yaws_rad = (np.arange(columns) + 0.5) * math.tau / columns - float(np.mean(off_rad))
    right = true_nearness(yaws_rad, down)
    found = np.maximum(depths.nearness, down[:, np.newaxis])
    by_walls = np.maximum(USUAL_NEARNESS, np.tile(down[:, np.newaxis], columns))
    wrong, wrong_by_walls = (float((np.abs(each / right - 1) > 0.15).mean()) for each in (found, by_walls))
    assert wrong < 0.12, f"{wrong_by_walls:.2f} by walls at the usual distance"


def test_a_floor_without_texture_changes_nothing() -> None:
    plain = np.full((240, 320, 3), 150, np.uint8)
    plain[140:] = 90
    frames = dict.fromkeys(range(8), plain)
    camera = TurnedCamera(CameraLens(320, 240, VIEW_RAD), Parallax(0.2, -0.1, np.full(KNOTS, USUAL_NEARNESS)))
    places = {number: Attitude(yaw_rad) for number, yaw_rad in enumerate(steps())}
    ring = ring_of(dict(enumerate(steps())), VIEW_RAD)
    found, found_places = align_pixels(frames, camera, places, ring)
    assert (found.parallax.ahead, found.parallax.left) == pytest.approx((0.2, -0.1), abs=0.01)
    assert [found_places[number].yaw_rad for number in places] == pytest.approx(steps(), abs=1e-3)
