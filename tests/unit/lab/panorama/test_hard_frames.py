"""Frames that something is wrong with: each is placed rightly, or named with the reason why it is not."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from eal_actors.device.world import load_world
from eal_actors.kernel.errors import ArgumentError
from eal_actors.lab.panorama import stitch
from eal_actors.lab.panorama.cylinder import CameraLens
from plugins.sim.camera.eye import Eye, PinholeLens
from plugins.sim.camera.movers import RobotAppearance, RobotAt
from plugins.sim.camera.render import expose, render
from plugins.sim.camera.scene import Scene
from tests.unit.lab.panorama.turning import (
    LAB,
    PLACE_M,
    VIEW_RAD,
    Image,
    lab,
    mean_error_rad,
    noisy,
    shots,
    shots_beside,
    ssim,
    steps,
    truth,
    yaw_error_rad,
)
from tests.unit.plugins.sim.ray_caster import psnr_db

MEANT = steps()
TRUE = noisy(MEANT, seed=3)
LENS = CameraLens(320, 240, VIEW_RAD)


def distorted(yaw_rad: float, k1: float) -> Image:
    """Return what a lens with radial distortion shows at a yaw, from a larger picture without."""
    x, y = ((np.arange(size) - (size - 1) / 2) / LENS.focal_px for size in (LENS.width, LENS.height))
    far = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 1, 2)
    straight = cv2.undistortPoints(far, np.eye(3), np.array([k1, 0.0, 0.0, 0.0])).reshape(240, 320, 2)
    return from_larger(yaw_rad, straight[..., 0], straight[..., 1])


def raised(yaw_rad: float, up_rad: float) -> Image:
    """Return what a camera that looks up shows at a yaw."""
    x, y = ((np.arange(size) - (size - 1) / 2) / LENS.focal_px for size in (LENS.width, LENS.height))
    right, down = np.meshgrid(x, y)
    ahead = math.cos(up_rad) + math.sin(up_rad) * down
    return from_larger(yaw_rad, right / ahead, (math.cos(up_rad) * down - math.sin(up_rad)) / ahead)


def from_larger(yaw_rad: float, right: NDArray[Any], down: NDArray[Any]) -> Image:
    """Return what a level camera at a yaw sees at tangents to the right and down, from a larger picture."""
    large = CameraLens(640, 480, 2 * math.atan(math.tan(VIEW_RAD / 2) * 1.4))
    picture = shots([yaw_rad], large.width, large.field_of_view_rad)[0]
    x = np.asarray(right * large.focal_px + 319.5, np.float32)
    y = np.asarray(down * large.focal_px + 239.5, np.float32)
    return np.asarray(cv2.remap(picture, x, y, cv2.INTER_AREA), np.uint8)


@cache
def good() -> tuple[Image, ...]:
    return tuple(shots(TRUE))


def ring_with(number: int, frame: Image) -> list[Image]:
    """Return a good ring but for one frame."""
    return [*good()[:number], frame, *good()[number + 1 :]]


def test_frames_of_different_exposure_become_equally_bright() -> None:
    exposures = [0.8, 1.2, 1.0, 0.9, 1.1, 0.7, 1.0, 1.1]
    panorama = stitch([expose(f, e, 0, 0) for f, e in zip(good(), exposures, strict=True)], MEANT, VIEW_RAD)
    corrected = np.array([panorama.gains[number] * exposure for number, exposure in enumerate(exposures)])
    assert corrected.max() / corrected.min() < 1.06, "but for what was too bright to tell"


@pytest.mark.slow
def test_noise_does_not_mislead() -> None:
    panorama = stitch([expose(f, 1, 12, seed) for seed, f in enumerate(good())], MEANT, VIEW_RAD)
    assert not panorama.unplaced
    assert math.degrees(yaw_error_rad(panorama, TRUE)) < 0.15


def test_a_blank_frame_is_named_and_the_panorama_begins_behind_it() -> None:
    panorama = stitch(ring_with(3, np.zeros_like(good()[3])), MEANT, VIEW_RAD)
    assert panorama.unplaced == {3: "is blank, but frame 2 and frame 4 beside it is not"}
    assert sorted(panorama.placed) == [0, 1, 2, 4, 5, 6, 7]
    assert panorama.yaws_rad[3] is None
    assert not panorama.is_full
    assert panorama.missing_rad == 0
    assert panorama.image.shape[1] == pytest.approx(panorama.px_per_rad * (2 * math.pi - math.radians(30)), rel=0.05)
    assert psnr_db(panorama.image, truth(panorama, TRUE, 1)) > 28


def test_a_blank_frame_among_many_leaves_no_hole() -> None:
    meant_rad = steps(12, math.radians(30))
    true_rad = noisy(meant_rad, seed=4)
    frames = shots(true_rad, 240, math.radians(80))
    frames[4] = np.full_like(frames[4], 180)
    panorama = stitch(frames, meant_rad, math.radians(80))
    assert list(panorama.unplaced) == [4]
    assert panorama.is_full
    assert panorama.missing_rad == 0


def test_nothing_but_blank_frames_is_an_error() -> None:
    with pytest.raises(ArgumentError, match="no two of the 8 frames fit together:\n  frame 0 is blank, as all"):
        stitch([np.zeros_like(frame) for frame in good()], MEANT, VIEW_RAD)


def test_a_frozen_camera_is_named() -> None:
    panorama = stitch(ring_with(3, good()[2]), MEANT, VIEW_RAD)
    assert panorama.unplaced == {
        3: "is identical to frame 2, although the camera had turned by 45 degrees: did it freeze?"
    }
    with pytest.raises(ArgumentError, match="did it freeze"):
        stitch([good()[2]] * 8, MEANT, VIEW_RAD)


def test_a_frame_from_elsewhere_is_named() -> None:
    maze = Scene(load_world(LAB.with_name("maze.yaml")))
    panorama = stitch(ring_with(5, shots([0.3], scene=maze)[0]), MEANT, VIEW_RAD)
    assert panorama.unplaced == {5: "differs from frame 4 and frame 6 in their overlap"}


def test_frames_whose_yaws_are_exchanged_are_named_with_where_they_fit() -> None:
    frames = list(good())
    frames[4], frames[5] = frames[5], frames[4]
    panorama = stitch(frames, MEANT, VIEW_RAD)
    assert sorted(panorama.unplaced) == [4, 5]
    assert "it fits -45 degrees from frame 5, but its yaw says +45" in panorama.unplaced[4]
    assert math.degrees(yaw_error_rad(panorama, TRUE)) < 0.05


def test_the_order_of_frames_does_not_matter() -> None:
    order = [3, 1, 7, 0, 2, 6, 4, 5]
    mixed = stitch([good()[n] for n in order], [MEANT[n] for n in order], VIEW_RAD)
    plain = stitch(good(), MEANT, VIEW_RAD)
    assert [mixed.yaws_rad[place] for place in range(8)] == pytest.approx([plain.yaws_rad[n] for n in order], abs=1e-5)


@pytest.mark.parametrize("number", [2, 4])
def test_part_of_a_ring_becomes_part_of_a_panorama(number: int) -> None:
    panorama = stitch(good()[:number], MEANT[:number], VIEW_RAD)
    assert not panorama.is_full
    assert panorama.closing_error_rad is None
    perfect = truth(panorama, TRUE[:number], 1)
    assert psnr_db(panorama.image, perfect) > 28
    assert ssim(panorama.image, perfect) > 0.9


def test_a_frame_that_was_taken_twice_does_no_harm() -> None:
    panorama = stitch([*good(), good()[0]], [*MEANT, MEANT[0] - 2 * math.pi], VIEW_RAD)
    assert not panorama.unplaced
    assert panorama.is_full
    assert psnr_db(panorama.image, truth(panorama, [*TRUE, TRUE[0]], 1)) > 28


def test_nine_frames_close_the_ring_with_the_last_on_the_first() -> None:
    meant_rad = steps(9)
    true_rad = noisy(meant_rad, seed=5)
    panorama = stitch(shots(true_rad), meant_rad, VIEW_RAD)
    assert math.degrees(yaw_error_rad(panorama, true_rad)) < 0.05


def test_frames_of_different_sizes_go_together() -> None:
    widths = [200, 240, 200, 160, 200, 200, 320, 200]
    frames = [shots([yaw_rad], width)[0] for yaw_rad, width in zip(TRUE, widths, strict=True)]
    panorama = stitch(frames, MEANT, VIEW_RAD)
    assert not panorama.unplaced
    assert math.degrees(yaw_error_rad(panorama, TRUE)) < 0.05
    assert panorama.px_per_rad == pytest.approx(160 / math.tan(VIEW_RAD / 2), rel=0.001), "as fine as the largest"


def test_a_frame_of_other_proportions_is_named() -> None:
    panorama = stitch(ring_with(2, np.ascontiguousarray(np.rot90(good()[2]))), MEANT, VIEW_RAD)
    assert panorama.unplaced == {2: "is 240 x 320 px, and the others are 320 x 240 px: it is from another camera"}


def test_a_bare_room_is_placed_by_its_shades() -> None:
    bare = Scene(load_world(LAB.with_name("empty.yaml")))
    panorama = stitch(shots(TRUE, scene=bare), MEANT, VIEW_RAD)
    assert set(panorama.placed.values()) == {"gradients"}
    assert math.degrees(yaw_error_rad(panorama, TRUE)) < 0.1


def test_noise_alone_is_no_contradiction() -> None:
    dull = [expose(np.full((240, 320, 3), 128, np.uint8), 1, 12, seed) for seed in range(8)]
    assert set(stitch(dull, MEANT, VIEW_RAD).placed.values()) == {"odometry only"}


def test_walls_that_show_nothing_leave_it_to_odometry() -> None:
    smooth = np.full((240, 320, 3), 150, np.uint8)
    smooth[120:] = 90  # the same edge of the floor all round: it tells how level a frame is, not where it looks
    frames = [smooth + np.uint8(number) for number in range(8)]
    panorama = stitch(frames, MEANT, VIEW_RAD)
    assert set(panorama.placed.values()) == {"odometry only"}
    assert panorama.yaws_rad == pytest.approx(MEANT)
    assert panorama.is_full


@pytest.mark.slow
@pytest.mark.parametrize("told_deg", [57, 63])
def test_a_wrong_field_of_view_is_corrected(told_deg: float) -> None:
    panorama = stitch(good(), MEANT, math.radians(told_deg))
    assert math.degrees(panorama.lens.field_of_view_rad) == pytest.approx(60, abs=0.3)
    assert math.degrees(yaw_error_rad(panorama, TRUE)) < 0.05
    assert psnr_db(panorama.image, truth(panorama, TRUE, 1)) > 28


@pytest.mark.slow
@pytest.mark.parametrize("k1", [-0.1, 0.1])
def test_a_lens_that_distorts_is_corrected(k1: float) -> None:
    frames = [distorted(yaw_rad, k1) for yaw_rad in TRUE]
    panorama = stitch(frames, MEANT, VIEW_RAD)
    assert panorama.lens.k1 == pytest.approx(k1, abs=0.01)
    assert math.degrees(yaw_error_rad(panorama, TRUE)) < 0.05
    assert psnr_db(panorama.image, truth(panorama, TRUE, 1)) > 28


@pytest.mark.slow
@pytest.mark.parametrize(("ahead_m", "left_m", "seed"), [(0.08, 0.0, 3), (0.08, 0.0, 5), (0.0, 0.08, 3)])
def test_a_camera_beside_the_axis_is_corrected(ahead_m: float, left_m: float, seed: int) -> None:
    """Features alone take the frames of seed 5 for those of another lens, and turn those of seed 3 by 4 degrees."""
    true_rad = noisy(MEANT, seed)
    panorama = stitch(shots_beside(true_rad, ahead_m, left_m, 640), MEANT, VIEW_RAD)
    assert (panorama.parallax.ahead, panorama.parallax.left) == pytest.approx(
        (ahead_m / PLACE_M[2], left_m / PLACE_M[2]), abs=0.01
    )
    assert panorama.lens.field_of_view_rad == VIEW_RAD
    assert math.degrees(yaw_error_rad(panorama, true_rad)) < 0.05
    perfect = truth(panorama, true_rad, 2)
    assert psnr_db(panorama.image, perfect) > 27
    assert ssim(panorama.image, perfect) > 0.92


@pytest.mark.slow
def test_a_robot_that_drives_by_is_shown_whole_or_not_at_all() -> None:
    """A robot stands on each seam while the frame to the left of it is taken, and has left before the next one."""
    look, lens = RobotAppearance(0.17, 0.5, (200, 60, 40), 0.5), PinholeLens(320, 240, 60)
    seams_rad = [yaw_rad - math.radians(22.5) for yaw_rad in TRUE]
    there = [
        RobotAt(look, PLACE_M[0] + 1.6 * math.cos(yaw_rad), PLACE_M[1] + 1.6 * math.sin(yaw_rad), 0.0)
        for yaw_rad in seams_rad
    ]
    frames = [render(lab(), [there[n]], Eye(*PLACE_M, yaw_rad, lens)) for n, yaw_rad in enumerate(TRUE)]
    panorama = stitch(frames, MEANT, VIEW_RAD)
    empty, crowded = truth(panorama, TRUE, 1), truth(panorama, TRUE, 1, there)
    shares = []
    for yaw_rad in seams_rad:
        middle = round((panorama.left_yaw_rad - mean_error_rad(panorama, TRUE) - yaw_rad) * panorama.px_per_rad)
        columns = np.arange(middle - 45, middle + 45) % panorama.image.shape[1]
        here, none, whole = (red_px(image[:, columns]) for image in (panorama.image, empty, crowded))
        shares.append((here - none) / (whole - none))
    assert all(abs(share) < 0.1 or abs(share - 1) < 0.1 for share in shares), shares


def red_px(image: Image) -> int:
    """Return how many pixels are as red as the robot."""
    red, green, blue = (image[..., channel].astype(int) for channel in range(3))
    return int(((red > 2 * green) & (red > 2 * blue)).sum())


def test_pictures_overrule_a_step_that_is_wrong() -> None:
    true_rad, told_rad = noisy(steps(6, math.radians(30)), seed=2), steps(6, math.radians(12))
    panorama = stitch(shots(true_rad), told_rad, VIEW_RAD)
    assert not panorama.unplaced
    assert math.degrees(yaw_error_rad(panorama, true_rad)) < 0.5
    pair = stitch(shots(true_rad[:2]), told_rad[:2], VIEW_RAD)
    assert not pair.unplaced
    assert math.degrees(yaw_error_rad(pair, true_rad[:2])) < 0.5


@pytest.mark.slow
def test_a_camera_that_is_not_quite_level_is_followed() -> None:
    panorama = stitch(ring_with(2, raised(TRUE[2], math.radians(0.8))), MEANT, VIEW_RAD)
    assert panorama.placed[2] == "features"
    assert psnr_db(panorama.image, truth(panorama, TRUE, 1)) > 26
    assert abs(mean_error_rad(panorama, TRUE)) < math.radians(3)
