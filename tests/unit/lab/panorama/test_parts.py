"""The parts of the pipeline, each against geometry that is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from eal_actors.lab.panorama.adjustment import adjust_bundle
from eal_actors.lab.panorama.cylinder import Attitude, CameraLens, Shift, resampled
from eal_actors.lab.panorama.features import find_features, shift_by_features
from eal_actors.lab.panorama.gradients import compare_gradients, gradients_of
from eal_actors.lab.panorama.parallax import KNOTS, Parallax, TurnedCamera, knot_weights
from eal_actors.lab.panorama.patches import patch_of
from eal_actors.lab.panorama.ring import closing_error_rad, ring_of
from tests.unit.lab.panorama.turning import VIEW_RAD, shots

LENS = CameraLens(320, 240, VIEW_RAD)
CAMERA = TurnedCamera(LENS, Parallax.none())


def degrees(*values: float) -> dict[int, float]:
    return {number: math.radians(value) for number, value in enumerate(values)}


def turned_by(degrees_: float) -> Shift:
    """Return the shift of points half way between two axes."""
    right_px = math.radians(degrees_) * LENS.focal_px
    halves_px = np.column_stack((np.full(5, right_px / 2), np.linspace(-60, 60, 5)))
    return Shift(right_px, halves_px, halves_px * (-1, 1), "features", 0.2)


def test_a_point_is_unrolled_to_its_bearing_and_height() -> None:
    lens = CameraLens(321, 241, math.radians(60))
    frame = np.zeros((241, 321, 3), np.uint8)
    frame[170:175, 240:245] = 255  # 80 px to the right of the axis, 52 below it, on the average
    bearing_rad = math.atan2(82, lens.focal_px)
    right_rad = np.arange(-0.5, 0.5, 0.001)
    down_px = np.arange(0, 100.0)
    x, y, _ = lens.pixels(right_rad, (down_px / lens.focal_px)[:, np.newaxis])
    image = resampled(frame, x, y)
    rows, columns = np.nonzero(image[..., 0] > 127)
    assert right_rad[columns].mean() == pytest.approx(bearing_rad, abs=0.002)
    assert down_px[rows].mean() == pytest.approx(52 * math.cos(bearing_rad), abs=0.6)


def test_a_patch_tells_where_its_frame_reaches() -> None:
    patch = patch_of(np.full((240, 320, 3), 9, np.uint8), CAMERA, 0.0)
    middle = patch.reaches.shape[1] // 2
    assert patch.reaches[:, middle].all()
    assert patch.reaches[:, 0].mean() == pytest.approx(math.cos(VIEW_RAD / 2), abs=0.02)


def test_features_and_gradients_find_the_turn_between_two_frames() -> None:
    turn_rad = math.radians(41.3)
    focal_px = LENS.focal_px
    one, two = (patch_of(frame, CAMERA, 0.0) for frame in shots([0.0, -turn_rad]))
    expected_px = math.radians(45) * focal_px
    by_features = shift_by_features(find_features(one), find_features(two), expected_px, focal_px)
    by_gradients = compare_gradients(gradients_of(one), gradients_of(two), expected_px, focal_px)
    assert by_features is not None
    assert by_gradients.shift is not None
    for shift in (by_features, by_gradients.shift):
        assert shift.right_px / focal_px == pytest.approx(turn_rad, abs=math.radians(0.05))
        assert (shift.first_px - shift.second_px)[:, 1].mean() == pytest.approx(0, abs=0.2)


def test_what_odometry_rules_out_is_not_found() -> None:
    focal_px = LENS.focal_px
    one, two = (patch_of(frame, CAMERA, 0.0) for frame in shots([0.0, -math.radians(30)]))
    expected_px = math.radians(43) * focal_px
    assert shift_by_features(find_features(one), find_features(two), expected_px, focal_px) is None
    assert compare_gradients(gradients_of(one), gradients_of(two), expected_px, focal_px).shift is None


@pytest.mark.parametrize("period_px", [16, 24])
def test_a_pattern_that_repeats_is_not_believed(period_px: int) -> None:
    stripes = np.full((240, 320, 3), 80, np.uint8)
    stripes[:, np.arange(320) % period_px < period_px // 2] = 170
    lens = CameraLens(320, 240, math.radians(20))
    patch = patch_of(stripes, TurnedCamera(lens, Parallax.none()), 0.0)
    found = compare_gradients(gradients_of(patch), gradients_of(patch), 90.0, lens.focal_px)
    assert found.shift is None
    assert not found.contradicts
    features = find_features(patch)
    assert shift_by_features(features, features, 90.0, lens.focal_px) is None


def test_a_ring_is_ordered_to_the_right_and_begins_behind_its_widest_gap() -> None:
    ring = ring_of(degrees(10, 100, -35, 55, 145), VIEW_RAD)
    assert ring.order == (4, 1, 3, 0, 2)
    assert not ring.is_closed
    assert [math.degrees(turn_rad) for turn_rad in ring.turns_rad] == pytest.approx([45, 45, 45, 45, 180])


def test_a_full_ring_is_closed_and_compares_its_last_frame_with_its_first() -> None:
    ring = ring_of(degrees(*range(0, -360, -45)), VIEW_RAD)
    assert ring.is_closed
    assert list(ring.pairs(VIEW_RAD)) == [(number, (number + 1) % 8) for number in range(8)]


def test_frames_at_one_yaw_are_no_full_ring() -> None:
    ring = ring_of(degrees(5, 5, 5), VIEW_RAD)
    assert not ring.is_closed
    assert sorted(ring.order) == [0, 1, 2]


@pytest.mark.parametrize("attitude", [Attitude(0.0), Attitude(0.3, 0.05, -0.04)])
@pytest.mark.parametrize("lens", [LENS, CameraLens(320, 240, VIEW_RAD, -0.15)])
def test_rays_are_the_inverse_of_pixels(lens: CameraLens, attitude: Attitude) -> None:
    pixels = np.array([[x, y] for x in (-150.0, -20.0, 140.0) for y in (-110.0, 5.0, 100.0)])
    right_rad, down = lens.rays(pixels, attitude.down_rad, attitude.roll_rad)
    x, y, _ = lens.pixels(right_rad, down, attitude)
    assert np.column_stack((x, y)) - (159.5, 119.5) == pytest.approx(pixels, abs=1e-3)


def test_turns_that_do_not_add_up_to_a_full_one_change_the_field_of_view() -> None:
    yaws_rad = degrees(*range(0, -360, -45))
    ring = ring_of(yaws_rad, VIEW_RAD)
    links = {(number, (number + 1) % 8): turned_by(45.5) for number in range(8)}
    error_rad = closing_error_rad(ring, links, LENS.focal_px)
    assert error_rad is not None
    assert math.degrees(error_rad) == pytest.approx(4)
    (lens, parallax), places = adjust_bundle(LENS, CAMERA, yaws_rad, yaws_rad, ring, links)
    assert not parallax.is_some
    assert lens.field_of_view_rad < VIEW_RAD
    assert [places[number].yaw_rad for number in range(8)] == pytest.approx([yaws_rad[n] for n in range(8)], abs=1e-4)


def test_a_turn_without_a_picture_takes_what_the_others_leave() -> None:
    yaws_rad = degrees(*range(0, -360, -45))
    ring = ring_of(yaws_rad, VIEW_RAD)
    links = {(number, number + 1): turned_by(44.9) for number in range(7)}
    (lens, parallax), places = adjust_bundle(LENS, CAMERA, yaws_rad, yaws_rad, ring, links)
    assert not parallax.is_some
    turns_rad = [places[number].yaw_rad - places[number + 1].yaw_rad for number in range(7)]
    assert max(turns_rad) - min(turns_rad) == pytest.approx(0, abs=1e-3)
    assert lens.field_of_view_rad == pytest.approx(VIEW_RAD, abs=math.radians(0.5))
    assert sum(places[number].yaw_rad - yaws_rad[number] for number in range(8)) == pytest.approx(0, abs=1e-3)


def test_what_the_camera_sees_beside_the_axis_is_brought_to_the_axis_and_back() -> None:
    parallax = Parallax(0.25, -0.15, np.linspace(0.05, 0.2, KNOTS))
    yaws_rad, down = np.linspace(0.1, 0.9, 9), np.linspace(-0.3, 0.4, 9)
    seen = parallax.seen_from_camera(0.5 - yaws_rad, down, yaws_rad)
    right_rad, found_down = parallax.seen_from_axis(*seen, knot_weights(yaws_rad) @ parallax.nearness)
    assert 0.5 - right_rad == pytest.approx(yaws_rad, abs=1e-9)
    assert found_down == pytest.approx(down, abs=1e-9)


@pytest.mark.parametrize(("ahead", "left"), [(0.25, 0.0), (0.0, 0.25), (0.0, -0.25)])
def test_a_camera_beside_the_axis_is_found_by_walls_and_floor(ahead: float, left: float) -> None:
    true = TurnedCamera(LENS, Parallax(ahead, left, 0.12 + 0.03 * np.sin(np.arange(KNOTS) * math.tau / KNOTS)))
    yaws_rad = degrees(*range(0, -360, -45))
    x_rad, down = (grid.ravel() for grid in np.meshgrid(np.radians([-6, -3, 0, 3, 6]), np.linspace(-0.3, 0.3, 9)))
    halves_rad, links = math.radians(22.5), {}
    for number in range(8):
        directions_rad = yaws_rad[number] - halves_rad - x_rad
        first, second = (
            true.parallax.seen_from_camera(x_rad + side * halves_rad, down, directions_rad) for side in (1, -1)
        )
        ends_px = np.column_stack(first) * LENS.focal_px, np.column_stack(second) * LENS.focal_px
        links[number, (number + 1) % 8] = Shift(math.radians(45) * LENS.focal_px, *ends_px, "features", 0.2)
    (lens, found), _ = adjust_bundle(LENS, CAMERA, yaws_rad, yaws_rad, ring_of(yaws_rad, VIEW_RAD), links)
    assert (found.ahead, found.left) == pytest.approx((ahead, left), abs=0.02)
    assert lens.field_of_view_rad == pytest.approx(VIEW_RAD, abs=1e-9), "the given lens explains it"
