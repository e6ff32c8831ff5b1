"""Stitching of frames, taken while the camera turned in place, into a panorama."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from eal_actors.kernel.errors import ArgumentError
from eal_actors.lab.panorama.blending import (
    Owners,
    PanoramaCanvas,
    PlacedFrame,
    blend,
    common_rows,
    find_seams,
    owners_of,
)
from eal_actors.lab.panorama.cylinder import CameraLens, Image, PlacedBy
from eal_actors.lab.panorama.parallax import Parallax
from eal_actors.lab.panorama.placement import FramePlacement, gains_of, place_frames
from eal_actors.lab.panorama.ring import Ring, ring_of
from eal_actors.lab.panorama.surroundings import with_surroundings

_LEAST_OVERLAP_DEG: Final = 10.0
_TOLERANCE_DEG: Final = 2.0  # tolerance for steps that odometry overestimates
_VIEW_DEG: Final = (10.0, 150.0)
_LEAST_SIDE_PX: Final = 32
_WIDEST_PX: Final = 16384  # largest width of a full ring; larger frames are scaled down
_LEAST_ROWS: Final = 16
_SAME_ASPECT: Final = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Panorama:
    """A cylindrical panorama: its columns are equidistant in yaw, clockwise from left to right.

    Attributes:
        image: shape (height, width, 3), red, green and blue, rows from the top; black outside of all frames.
        left_yaw_rad: yaw of the image's left edge, in the frame of the given yaws.
        px_per_rad: columns per radian; rows have the same scale at the horizon.
        horizon_px: distance of the horizon from the image's upper edge.
        is_full: whether the image covers a full turn, so that its right edge joins its left edge.
        missing_rad: angle between left and right edge that no frame shows.
        yaws_rad: yaw of each frame, in the given order; None for frames that were not placed.
        placed: source of each placed frame's direction, by its number from 0.
        gains: brightness gain of each placed frame.
        lens: the camera's lens, as the frames determine it.
        parallax: its position beside the axis of rotation, and the distances of what stands round it, as the frames
            determine them.
        closing_error_rad: sum of the turns by pictures minus a full turn, before its distribution round the ring; a
            large value means a wrong field of view. None if unknown, for example for an open ring.
    """

    image: Image
    left_yaw_rad: float
    px_per_rad: float
    horizon_px: float
    is_full: bool
    missing_rad: float
    yaws_rad: tuple[float | None, ...]
    placed: Mapping[int, PlacedBy]
    unplaced: Mapping[int, str]
    gains: Mapping[int, float]
    lens: CameraLens
    parallax: Parallax
    closing_error_rad: float | None


def stitch(
    frames: Sequence[NDArray[Any]],
    yaws_rad: Sequence[float],
    field_of_view_rad: float,
    *,
    names: Sequence[str] | None = None,
) -> Panorama:
    """Stitch frames of a level camera that turned in place.

    The order of the frames and the start of the ring do not matter. The result is deterministic.

    Args:
        frames: at least two of shape (height, width, 3), unsigned bytes: red, green and blue, rows from the top. Sizes
            may differ, but not proportions; the resolution of the largest frame is kept.
        yaws_rad: yaw of the camera at each frame by odometry, counter-clockwise, from any origin; it may be wrong by
            12 degrees between consecutive frames.
        field_of_view_rad: angle between the left and right edges of a frame: at least 10 degrees more than the steps.
        names: names of the frames in messages; default: `frame 0` and so on.

    Raises:
        ArgumentError: a frame is not an image, there are too few frames, they are too far apart, or no two of them fit.

    Thread: any; it may take seconds.
    """
    names = names or [f"frame {number}" for number in range(len(frames))]
    usable, odd = check_frames(frames, yaws_rad, field_of_view_rad, names)
    lens = CameraLens.of(next(iter(usable.values())), field_of_view_rad)
    placement = with_surroundings(usable, place_frames(usable, yaws_rad, lens, names))
    unplaced = dict(sorted({**odd, **placement.unplaced}.items()))
    if len(placement.places) < 2:
        reasons = "".join(f"\n  {names[number]} {reason}" for number, reason in unplaced.items())
        raise ArgumentError(f"no two of the {len(frames)} frames fit together:{reasons}")
    return _render(usable, placement, unplaced, len(frames))


def check_frames(
    frames: Sequence[NDArray[Any]], yaws_rad: Sequence[float], field_of_view_rad: float, names: Sequence[str]
) -> tuple[dict[int, Image], dict[int, str]]:
    """Check frames as `stitch` needs them; return those of equal size by number, and why others are left out."""
    _validate(frames, yaws_rad, field_of_view_rad, names)
    usable, odd = _equalise_sizes(frames, field_of_view_rad)
    _check_steps({number: yaws_rad[number] for number in usable}, field_of_view_rad)
    return usable, odd


def _validate(
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
            raise ArgumentError(f"the yaw of {name} is {yaw_rad}: not an angle")
        if frame.ndim != 3 or frame.shape[2] != 3 or frame.dtype != np.uint8:
            raise ArgumentError(
                f"{name} must be of shape (height, width, 3) and type uint8, not {frame.shape} and {frame.dtype}"
            )
        if min(frame.shape[:2]) < _LEAST_SIDE_PX:
            height, width = frame.shape[:2]
            raise ArgumentError(f"{name} is {width} x {height} px; each side needs at least {_LEAST_SIDE_PX} px")


def _equalise_sizes(
    frames: Sequence[NDArray[Any]], field_of_view_rad: float
) -> tuple[dict[int, Image], dict[int, str]]:
    """Return the frames scaled to the largest one, and why frames of other proportions are left out."""
    aspects = [frame.shape[1] / frame.shape[0] for frame in frames]
    usual = sorted(aspects)[len(aspects) // 2]
    fits = [abs(aspect / usual - 1) <= _SAME_ASPECT for aspect in aspects]
    height, width, _ = max(frame.shape for frame, fit in zip(frames, fits, strict=True) if fit)
    if width > (most_px := int(_WIDEST_PX / math.pi * math.tan(field_of_view_rad / 2))):
        width, height = most_px, max(1, round(height * most_px / width))
    usable, odd = {}, {}
    for number, (frame, fit) in enumerate(zip(frames, fits, strict=True)):
        if fit:
            usable[number] = _resize(np.ascontiguousarray(frame), width, height)
        else:
            size = f"{frame.shape[1]} x {frame.shape[0]} px"
            odd[number] = f"is {size}, and the others are {width} x {height} px: it is from another camera"
    return usable, odd


def _resize(frame: Image, width: int, height: int) -> Image:
    if frame.shape[:2] == (height, width):
        return frame
    way = cv2.INTER_AREA if frame.shape[1] > width else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(frame, (width, height), interpolation=way), np.uint8)


def _check_steps(yaws_rad: Mapping[int, float], field_of_view_rad: float) -> None:
    """Raise ArgumentError if the frames typically do not overlap; a few gaps are allowed."""
    turns_deg = [math.degrees(turn_rad) for _, _, turn_rad in ring_of(yaws_rad, field_of_view_rad).neighbours()]
    steps_deg = sorted(turn_deg for turn_deg in turns_deg if turn_deg > _TOLERANCE_DEG)
    step_deg = steps_deg[len(steps_deg) // 2] if steps_deg else 0.0
    if step_deg + _LEAST_OVERLAP_DEG > math.degrees(field_of_view_rad) + _TOLERANCE_DEG:
        raise ArgumentError(
            f"the frames are about {step_deg:.0f} degrees apart, which needs a field of view of "
            f"{step_deg + _LEAST_OVERLAP_DEG:.0f} degrees; it is {math.degrees(field_of_view_rad):g}"
        )


def _render(
    frames: Mapping[int, Image], placement: FramePlacement, unplaced: Mapping[int, str], count: int
) -> Panorama:
    gains, lens = gains_of(placement), placement.camera.lens
    views = {
        number: PlacedFrame(frames[number], placement.camera, attitude, gains[number])
        for number, attitude in placement.places.items()
    }
    yaws_rad = {number: attitude.yaw_rad for number, attitude in placement.places.items()}
    ring = ring_of(yaws_rad, 2 * lens.half_view_rad)
    canvas, owners = _canvas(views, ring, lens)
    return Panorama(
        image=blend(views, find_seams(views, ring.order, owners, canvas), canvas),
        left_yaw_rad=canvas.left_rad,
        px_per_rad=canvas.px_per_rad,
        horizon_px=-float(canvas.top_px),
        is_full=canvas.is_closed,
        missing_rad=float((owners < 0).sum()) / canvas.px_per_rad,
        yaws_rad=tuple(yaws_rad.get(number) for number in range(count)),
        placed=placement.how,
        unplaced=unplaced,
        gains=gains,
        lens=lens,
        parallax=placement.camera.parallax,
        closing_error_rad=placement.closing_error_rad,
    )


def _canvas(views: Mapping[int, PlacedFrame], ring: Ring, lens: CameraLens) -> tuple[PanoramaCanvas, Owners]:
    """Return the canvas, and the frame nearest to each of its columns."""
    first_rad = views[ring.order[0]].attitude.yaw_rad
    if ring.is_closed:
        width = round(2 * math.pi * lens.focal_px)
        px_per_rad = width / (2 * math.pi)
        left_rad = first_rad + math.pi
    else:
        px_per_rad = lens.focal_px
        width = int((math.fsum(ring.turns_rad[:-1]) + 2 * lens.half_view_rad) * px_per_rad)
        left_rad = first_rad + lens.half_view_rad
    columns_rad = left_rad - (np.arange(width) + 0.5) / px_per_rad
    owners = owners_of(views, columns_rad)
    top_px, bottom_px = common_rows(views, columns_rad, owners, px_per_rad)
    if bottom_px - top_px < _LEAST_ROWS:
        raise ArgumentError(f"the frames have only {max(bottom_px - top_px, 0)} rows in common")
    return PanoramaCanvas(left_rad, width, top_px, bottom_px, px_per_rad, ring.is_closed), owners
