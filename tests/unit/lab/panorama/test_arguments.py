"""Invalid arguments and warnings of `stitch`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from eal_actors.kernel.errors import ArgumentError
from eal_actors.lab.panorama import stitch
from tests.unit.lab.panorama.turning import STEP_RAD, VIEW_RAD, noisy, shots, steps

FRAME = np.zeros((48, 64, 3), np.uint8)


@pytest.mark.parametrize(
    ("frames", "yaws_rad", "view_deg", "message"),
    [
        ([], [], 60, "at least two frames, not 0"),
        ([FRAME], [0.0], 60, "at least two frames, not 1"),
        ([FRAME] * 3, [0.0, 1.0], 60, "3 frames and 2 yaws"),
        ([FRAME] * 2, [0.0, math.nan], 60, "the yaw of frame 1 is nan"),
        ([FRAME] * 2, [0.0, 0.5], 5, "from 10 to 150 degrees, not 5"),
        ([FRAME] * 2, [0.0, 0.5], math.nan, "from 10 to 150 degrees, not nan"),
        ([FRAME, FRAME[..., 0]], [0.0, 0.5], 60, r"frame 1 must be of shape \(height, width, 3\).*\(48, 64\)"),
        ([FRAME, FRAME.astype(float)], [0.0, 0.5], 60, "frame 1 must be .* uint8, not .* float64"),
        ([FRAME, FRAME[:20]], [0.0, 0.5], 60, "frame 1 is 64 x 20 px; each side needs at least 32 px"),
    ],
)
def test_what_is_no_ring_of_frames_is_refused(
    frames: list[Any], yaws_rad: list[float], view_deg: float, message: str
) -> None:
    with pytest.raises(ArgumentError, match=message):
        stitch(frames, yaws_rad, math.radians(view_deg))


@pytest.mark.parametrize("number", [2, 8])
def test_steps_that_leave_too_little_overlap_are_refused_before_any_work(number: int) -> None:
    with pytest.raises(ArgumentError, match="45 degrees apart, which needs a field of view of 55 degrees; it is 50"):
        stitch([FRAME] * number, steps(number), math.radians(50))


@pytest.mark.slow
def test_ten_degrees_of_overlap_are_enough() -> None:
    view_rad = STEP_RAD + math.radians(10)
    true_rad = noisy(steps(), seed=2)
    panorama = stitch(shots(true_rad, 240, view_rad), steps(), view_rad)
    assert not panorama.unplaced
    assert panorama.is_full


def test_messages_call_frames_by_their_names() -> None:
    with pytest.raises(ArgumentError, match=r"b\.png is 64 x 20 px"):
        stitch([FRAME, FRAME[:20]], [0.0, 0.5], VIEW_RAD, names=["a.png", "b.png"])


def test_the_same_frames_give_the_same_panorama_and_are_left_as_they_are() -> None:
    frames = shots(noisy(steps(3), seed=1))
    before = [frame.copy() for frame in frames]
    one, other = (stitch(frames, steps(3), VIEW_RAD) for _ in range(2))
    np.testing.assert_array_equal(one.image, other.image)
    assert one.yaws_rad == other.yaws_rad
    assert all(np.array_equal(frame, old) for frame, old in zip(frames, before, strict=True))
