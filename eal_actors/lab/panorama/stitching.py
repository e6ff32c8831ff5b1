"""`stitch`: frames that a camera took while it turned in place become one seamless picture."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from eal_actors.kernel.errors import ArgumentError
from eal_actors.lab.panorama.blending import Canvas, View, blend, common_rows, owners_of
from eal_actors.lab.panorama.cylinder import Image, Lens
from eal_actors.lab.panorama.gains import gains_of
from eal_actors.lab.panorama.placing import Placing, place
from eal_actors.lab.panorama.ring import ring_of
from eal_actors.lab.panorama.shift import How

_LEAST_OVERLAP_DEG: Final = 10.0
_ALLOWANCE_DEG: Final = 2.0
"""Odometry may have the steps so much wider than they were."""
_VIEW_DEG: Final = (10.0, 150.0)
_LEAST_SIDE_PX: Final = 32
_WIDEST_PX: Final = 16384
"""A full ring gets no wider: larger frames are made smaller."""
_LEAST_ROWS: Final = 16
_SAME_ASPECT: Final = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Panorama:
    """Frames in one picture, on a cylinder: columns are equally far apart in yaw, from left to right clockwise.

    Attributes:
        image: shape (height, width, 3), red, green and blue, rows from the top; black where no frame reaches.
        left_yaw_rad: yaw of the image's left edge, in the frame of the yaws that were given.
        px_per_rad: columns in a radian; the rows are as large where they meet the horizon.
        horizon_px: how far the horizon is below the image's upper edge.
        is_full: whether the image goes all the way round, so that its right edge joins its left one.
        missing_rad: how much of the way from left to right no frame shows.
        yaws_rad: where each frame looks, in the order given; None for those that could not be placed.
        placed: what each placed frame was placed by, by its number from 0.
        unplaced: why the other frames could not be placed, by their numbers.
        gains: the factor that each placed frame's brightness was corrected by.
        closing_error_rad: how much more than a full turn the pictures alone told, before it was spread round the ring;
            much of it means that the field of view is another. None where that is not known, as where the ring is open.
    """

    image: Image
    left_yaw_rad: float
    px_per_rad: float
    horizon_px: float
    is_full: bool
    missing_rad: float
    yaws_rad: tuple[float | None, ...]
    placed: Mapping[int, How]
    unplaced: Mapping[int, str]
    gains: Mapping[int, float]
    closing_error_rad: float | None


def stitch(
    frames: Sequence[NDArray[Any]],
    yaws_rad: Sequence[float],
    field_of_view_rad: float,
    *,
    names: Sequence[str] | None = None,
) -> Panorama:
    """Stitch frames of a level camera that turned in place.

    The order of the frames does not matter, and neither does where the ring begins. The same arguments give the same
    picture.

    Args:
        frames: at least two of shape (height, width, 3), unsigned bytes: red, green and blue, rows from the top. Sizes
            may differ if their proportions do not; the largest one's detail is kept.
        yaws_rad: where odometry has the camera looking at each frame, counter-clockwise, from anywhere; it may be
            wrong by 12 degrees from one frame to the next.
        field_of_view_rad: angle between the left and the right edge of a frame: 10 degrees more than the steps.
        names: what messages call the frames; `frame 0` and so on if left out.

    Raises:
        ArgumentError: frames that are none, too few, or too far apart; or no two of them fit.

    Thread: any; it may take seconds.
    """
    names = names or [f"frame {number}" for number in range(len(frames))]
    _check(frames, yaws_rad, field_of_view_rad, names)
    usable, odd = _of_one_shape(frames, field_of_view_rad)
    _check_steps({number: yaws_rad[number] for number in usable}, field_of_view_rad)
    placing = place(usable, yaws_rad, field_of_view_rad, names)
    unplaced = dict(sorted({**odd, **placing.unplaced}.items()))
    if len(placing.places) < 2:
        reasons = "".join(f"\n  {names[number]} {reason}" for number, reason in unplaced.items())
        raise ArgumentError(f"no two of the {len(frames)} frames fit together:{reasons}")
    return _painted(usable, placing, unplaced, len(frames), field_of_view_rad)


def _check(
    frames: Sequence[NDArray[Any]], yaws_rad: Sequence[float], field_of_view_rad: float, names: Sequence[str]
) -> None:
    least_deg, most_deg = _VIEW_DEG
    if not least_deg <= math.degrees(field_of_view_rad) <= most_deg:
        raise ArgumentError(
            f"the field of view must be from {least_deg:g} to {most_deg:g} degrees, "
            f"not {math.degrees(field_of_view_rad):g}"
        )
    if len(frames) < 2:
        raise ArgumentError(f"a panorama needs at least two frames, not {len(frames)}")
    if len(frames) != len(yaws_rad):
        raise ArgumentError(f"each frame needs its yaw: there are {len(frames)} frames and {len(yaws_rad)} yaws")
    for name, frame, yaw_rad in zip(names, frames, yaws_rad, strict=True):
        if not math.isfinite(yaw_rad):
            raise ArgumentError(f"the yaw of {name} is {yaw_rad}, which is no angle")
        if frame.ndim != 3 or frame.shape[2] != 3 or frame.dtype != np.uint8:
            raise ArgumentError(
                f"{name} must be of shape (height, width, 3) and type uint8, not {frame.shape} and {frame.dtype}"
            )
        if min(frame.shape[:2]) < _LEAST_SIDE_PX:
            height, width = frame.shape[:2]
            raise ArgumentError(f"{name} is only {width} x {height} px; {_LEAST_SIDE_PX} px a side are needed")


def _of_one_shape(frames: Sequence[NDArray[Any]], field_of_view_rad: float) -> tuple[dict[int, Image], dict[int, str]]:
    """Return the frames as large as the largest one, and why some cannot be made so: their proportions are others."""
    aspects = [frame.shape[1] / frame.shape[0] for frame in frames]
    usual = sorted(aspects)[len(aspects) // 2]
    fits = [abs(aspect / usual - 1) <= _SAME_ASPECT for aspect in aspects]
    height, width, _ = max(frame.shape for frame, fit in zip(frames, fits, strict=True) if fit)
    if width > (most_px := int(_WIDEST_PX / math.pi * math.tan(field_of_view_rad / 2))):
        width, height = most_px, max(1, round(height * most_px / width))
    usable, odd = {}, {}
    for number, (frame, fit) in enumerate(zip(frames, fits, strict=True)):
        if fit:
            usable[number] = _resized(np.ascontiguousarray(frame), width, height)
        else:
            size = f"{frame.shape[1]} x {frame.shape[0]} px"
            odd[number] = f"is {size}, and the others are {width} x {height} px: the same lens cannot have taken it"
    return usable, odd


def _resized(frame: Image, width: int, height: int) -> Image:
    if frame.shape[:2] == (height, width):
        return frame
    way = cv2.INTER_AREA if frame.shape[1] > width else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(frame, (width, height), interpolation=way), np.uint8)


def _check_steps(yaws_rad: Mapping[int, float], field_of_view_rad: float) -> None:
    """Refuse steps that are too wide for the frames to overlap; a few gaps are no reason to."""
    turns_deg = [math.degrees(turn_rad) for _, _, turn_rad in ring_of(yaws_rad, field_of_view_rad).neighbours()]
    steps_deg = sorted(turn_deg for turn_deg in turns_deg if turn_deg > _ALLOWANCE_DEG)
    step_deg = steps_deg[len(steps_deg) // 2] if steps_deg else 0.0
    if step_deg + _LEAST_OVERLAP_DEG > math.degrees(field_of_view_rad) + _ALLOWANCE_DEG:
        raise ArgumentError(
            f"the frames are about {step_deg:.0f} degrees apart, which needs a field of view of "
            f"{step_deg + _LEAST_OVERLAP_DEG:.0f} degrees; it is {math.degrees(field_of_view_rad):g}"
        )


def _painted(
    frames: Mapping[int, Image], placing: Placing, unplaced: Mapping[int, str], count: int, field_of_view_rad: float
) -> Panorama:
    gains = gains_of(placing)
    views = {}
    for number, (yaw_rad, down_rad) in placing.places.items():
        lens = Lens.of(frames[number], field_of_view_rad)
        views[number] = View(frames[number], lens, yaw_rad, down_rad, gains[number])
    canvas, owners = _canvas(views, field_of_view_rad)
    return Panorama(
        image=blend(views, owners, canvas),
        left_yaw_rad=canvas.left_rad,
        px_per_rad=canvas.px_per_rad,
        horizon_px=-float(canvas.top_px),
        is_full=canvas.is_closed,
        missing_rad=float((owners < 0).sum()) / canvas.px_per_rad,
        yaws_rad=tuple(placing.places[number][0] if number in placing.places else None for number in range(count)),
        placed=placing.how,
        unplaced=unplaced,
        gains=gains,
        closing_error_rad=placing.closing_error_rad,
    )


def _canvas(views: Mapping[int, View], field_of_view_rad: float) -> tuple[Canvas, NDArray[np.int64]]:
    """Return what to paint, and which frame each column of it is taken from."""
    ring = ring_of({number: view.yaw_rad for number, view in views.items()}, field_of_view_rad)
    focal_px = views[ring.order[0]].lens.focal_px
    if ring.is_closed:
        width = round(2 * math.pi * focal_px)
        px_per_rad = width / (2 * math.pi)
        left_rad = views[ring.order[0]].yaw_rad + math.pi
    else:
        px_per_rad = focal_px
        width = int((math.fsum(ring.turns_rad[:-1]) + field_of_view_rad) * px_per_rad)
        left_rad = views[ring.order[0]].yaw_rad + field_of_view_rad / 2
    columns_rad = left_rad - (np.arange(width) + 0.5) / px_per_rad
    owners = owners_of(views, columns_rad)
    top_px, bottom_px = common_rows(views, columns_rad, owners, px_per_rad)
    if bottom_px - top_px < _LEAST_ROWS:
        raise ArgumentError(f"the frames have only {max(bottom_px - top_px, 0)} rows in common all the way round")
    return Canvas(left_rad, width, top_px, bottom_px, px_per_rad, ring.is_closed), owners
