"""Directions of the frames, by odometry and corrected by their overlaps; and their brightness gains."""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Final, NamedTuple

import cv2
import numpy as np

from eal_actors.lab.panorama.adjustment import adjust_bundle
from eal_actors.lab.panorama.cylinder import (
    WINDOW_RAD,
    Attitude,
    CameraLens,
    Floats,
    Image,
    PlacedBy,
    scaled_down,
    wrapped_rad,
)
from eal_actors.lab.panorama.features import Features, find_features, shift_by_features
from eal_actors.lab.panorama.gaps import link_across_gap
from eal_actors.lab.panorama.gradients import (
    Comparison,
    DoubtfulShift,
    Gradients,
    compare_gradients,
    doubtful_shift,
    gradients_of,
)
from eal_actors.lab.panorama.parallax import Parallax, TurnedCamera
from eal_actors.lab.panorama.patches import Patch, patch_of
from eal_actors.lab.panorama.ring import Links, Ring, closing_error_rad, ring_of

_MOST_PASSES: Final = 2
_SAME_LENS_PX: Final = 0.5
_COARSE_WIDTH: Final = 320  # of frames for comparisons, in pixels: things look alike from places 6 cm apart
_FINE_WIDTH: Final = 800  # for a camera on the axis
_BLANK: Final = 2.0  # standard deviation of grey levels up to which a picture counts as blank
_UNLIKE: Final = 16.0  # difference in grey levels from which a blank frame contradicts its neighbour in their overlap
_DARKEST: Final = 4
_BRIGHTEST: Final = 250  # pixels outside of these levels are clipped, and say nothing about brightness
_LEVELS_SIGMA: Final = 4.0
_GAIN_SIGMA: Final = 0.3
_FEWEST_PX: Final = 200


@dataclass(frozen=True, slots=True)
class FramePlacement:
    """Directions of the frames.

    Attributes:
        camera: its lens and its position, as the frames determine them.
        how: source of each placed frame's direction.
        closing_error_rad: sum of the turns minus a full turn; None if unknown.
        patches: the placed frames, projected for comparison.
    """

    camera: TurnedCamera
    places: Mapping[int, Attitude]
    how: Mapping[int, PlacedBy]
    unplaced: Mapping[int, str]
    closing_error_rad: float | None
    patches: Mapping[int, Patch]


class _CompareBy(NamedTuple):
    """The camera model by which frames are projected for comparison, and their largest width."""

    camera: TurnedCamera
    width: int


def place_frames(
    frames: Mapping[int, Image], yaws_rad: Sequence[float], lens: CameraLens, names: Sequence[str]
) -> FramePlacement:
    """Determine the lens and the direction of each frame.

    A frame keeps its yaw by odometry if its overlaps have no usable structure. A frame that contradicts all of its
    neighbours is left out. The frames have one size, and the yaws by odometry are in the order of their numbers.
    `names` are for messages.
    """
    coarse = _settle(frames, yaws_rad, lens, _CompareBy(TurnedCamera(lens, Parallax.none()), _COARSE_WIDTH), names)
    if coarse.camera.parallax.is_some or lens.width <= _COARSE_WIDTH:
        return coarse
    return _settle(frames, yaws_rad, lens, _CompareBy(coarse.camera, _FINE_WIDTH), names)


def _settle(
    frames: Mapping[int, Image], yaws_rad: Sequence[float], given: CameraLens, way: _CompareBy, names: Sequence[str]
) -> FramePlacement:
    """Compare the frames again, as long as that changes the camera."""
    placement = _place(frames, yaws_rad, given, way, names)
    for _ in range(_MOST_PASSES):
        if _apart_px(placement.camera, way.camera) < _SAME_LENS_PX:
            break
        way = way._replace(camera=placement.camera)  # frames that a better model projects show more of their overlaps
        placement = _place(frames, yaws_rad, given, way, names)
    return placement


def _apart_px(camera: TurnedCamera, other: TurnedCamera) -> float:
    """Return how far apart two models see the corners of the frame, in pixels."""
    width, height = camera.lens.width, camera.lens.height
    corners = np.array([[x * width / 2, y * height / 2] for x in (-1, 1) for y in (-1, 1)])
    seen = [
        np.stack(each.parallax.seen_from_axis(*each.lens.rays(corners), np.full(4, each.parallax.nearness.mean())))
        for each in (camera, other)
    ]
    return float(np.abs(seen[0] - seen[1]).max()) * camera.lens.focal_px


def _place(
    frames: Mapping[int, Image], yaws_rad: Sequence[float], given: CameraLens, way: _CompareBy, names: Sequence[str]
) -> FramePlacement:
    camera = way.camera
    views = {number: _ComparedFrame(frame, way, yaws_rad[number]) for number, frame in frames.items()}
    if all(view.is_blank for view in views.values()):
        return FramePlacement(camera, {}, {}, dict.fromkeys(frames, "is blank, as all frames are"), None, {})
    field_of_view_rad = 2 * camera.lens.half_view_rad
    unplaced = _frozen(frames, yaws_rad, names)
    yaws_rad = _believable(views, yaws_rad, unplaced, field_of_view_rad)
    compared: dict[tuple[int, int], Comparison] = {}
    while left := {number: yaws_rad[number] for number in frames if number not in unplaced}:
        ring = ring_of(left, field_of_view_rad)
        pairs = list(ring.pairs(field_of_view_rad))
        for one, other in pairs:
            if (one, other) not in compared:
                compared[one, other] = _compare(views[one], views[other], wrapped_rad(yaws_rad[one] - yaws_rad[other]))
        outliers = _find_outliers(pairs, compared)
        if not outliers:
            links = {pair: shift for pair in pairs if (shift := compared[pair].shift) is not None}
            links |= link_across_gap(ring, links, partial(_doubtful, views, yaws_rad))
            return _solve(left, ring, links, unplaced, views, given, may_be_beside=way.width == _COARSE_WIDTH)
        unplaced |= {number: _reason(number, outliers[number], views, yaws_rad, names) for number in sorted(outliers)}
    return FramePlacement(camera, {}, {}, unplaced, None, {})


class _ComparedFrame:
    """A frame for comparisons; features and gradients are computed lazily."""

    def __init__(self, frame: Image, way: _CompareBy, yaw_rad: float) -> None:
        small = scaled_down(frame, way.width)
        self.camera: Final = way.camera._replace(lens=way.camera.lens.scaled(small.shape[1], small.shape[0]))
        self.yaw_rad: Final = yaw_rad
        self.patch: Final = patch_of(small, self.camera, yaw_rad)
        self.is_blank: Final = float(self.patch.grey[self.patch.reaches].std()) <= _BLANK

    @cached_property
    def features(self) -> Features:
        return find_features(self.patch)

    @cached_property
    def gradients(self) -> Gradients:
        return gradients_of(self.patch)


def _frozen(frames: Mapping[int, Image], yaws_rad: Sequence[float], names: Sequence[str]) -> dict[int, str]:
    """Return the frames that equal an earlier one although the camera had turned, with the reason to leave them out."""
    seen: dict[bytes, int] = {}
    copies: dict[int, str] = {}
    for number, frame in frames.items():
        earlier = seen.setdefault(hashlib.blake2b(np.ascontiguousarray(frame).data).digest(), number)
        turned_rad = abs(wrapped_rad(yaws_rad[number] - yaws_rad[earlier]))
        if turned_rad > WINDOW_RAD and float(frame.std()) > _BLANK:
            copies[number] = (
                f"is identical to {names[earlier]}, although the camera had turned by "
                f"{math.degrees(turned_rad):.0f} degrees: did it freeze?"
            )
    return copies


def _believable(
    views: Mapping[int, _ComparedFrame], yaws_rad: Sequence[float], unplaced: Mapping[int, str], view_rad: float
) -> Sequence[float]:
    """Return the yaws by odometry; or by the pictures, if each fits the one before it but at quite another turn.

    A step that was mistyped, or odometry of the wrong scale, must not make the frames strangers to one another.
    """
    numbers = [number for number in sorted(views) if number not in unplaced]
    found = dict(enumerate(yaws_rad))
    is_overruled = False
    for before, after in itertools.pairwise(numbers):
        one, other = views[before], views[after]
        turn_rad = wrapped_rad(yaws_rad[before] - yaws_rad[after])
        if _compare(one, other, turn_rad).shift is None:
            px_per_rad = one.patch.px_per_rad
            shift = shift_by_features(one.features, other.features, 0.0, px_per_rad, window_rad=view_rad)
            if shift is None:
                return yaws_rad
            turn_rad, is_overruled = shift.right_px / px_per_rad, True
        found[after] = found[before] - turn_rad
    return [found[number] for number in range(len(yaws_rad))] if is_overruled else yaws_rad


def _compare(first: _ComparedFrame, second: _ComparedFrame, expected_rad: float) -> Comparison:
    px_per_rad = first.patch.px_per_rad
    expected_px = expected_rad * px_per_rad
    if first.is_blank or second.is_blank:
        return Comparison(None, contradicts=_are_unlike(first.patch, second.patch, round(expected_px)))
    shift = shift_by_features(first.features, second.features, expected_px, px_per_rad)
    if shift is not None:
        return Comparison(shift, contradicts=False)
    return compare_gradients(first.gradients, second.gradients, expected_px, px_per_rad)


def _doubtful(
    views: Mapping[int, _ComparedFrame], yaws_rad: Sequence[float], one: int, other: int
) -> DoubtfulShift | None:
    first, second = views[one], views[other]
    if first.is_blank or second.is_blank:
        return None
    expected_px = wrapped_rad(yaws_rad[one] - yaws_rad[other]) * first.patch.px_per_rad
    return doubtful_shift(first.gradients, second.gradients, expected_px, first.patch.px_per_rad)


def _are_unlike(first: Patch, second: Patch, right_px: int) -> bool:
    """Return whether two frames differ where they overlap if the second's axis is so far to the right."""
    one, other, common = _overlap(first, second, right_px)
    if not common.any():
        return False
    return float(np.abs(cv2.subtract(one, other, dtype=cv2.CV_32F))[common].mean()) > _UNLIKE


def _overlap(first: Patch, second: Patch, right_px: int) -> tuple[Image, Image, np.ndarray]:
    """Return what two patches show of the same part of the cylinder, and where both reach, (h, w)."""
    width = first.grey.shape[1]
    of_first = slice(max(0, right_px), width + min(0, right_px))
    of_second = slice(max(0, -right_px), width + min(0, -right_px))
    common = first.reaches[:, of_first] & second.reaches[:, of_second]
    return first.colours[:, of_first], second.colours[:, of_second], common


def _find_outliers(
    pairs: Sequence[tuple[int, int]], compared: Mapping[tuple[int, int], Comparison]
) -> dict[int, list[int]]:
    """Return the frames that fit no other frame, with the frames that they contradict."""
    fitting = {number for pair in pairs if compared[pair].shift is not None for number in pair}
    outliers: dict[int, list[int]] = {}
    for one, other in pairs:
        if compared[one, other].contradicts:
            for number, neighbour in ((one, other), (other, one)):
                if number not in fitting:
                    outliers.setdefault(number, []).append(neighbour)
    return outliers


def _reason(
    number: int,
    neighbours: Sequence[int],
    views: Mapping[int, _ComparedFrame],
    yaws_rad: Sequence[float],
    names: Sequence[str],
) -> str:
    """Return why a frame is left out, and which other frame it fits."""
    beside = _join_names([names[neighbour] for neighbour in sorted(neighbours)])
    view = views[number]
    if view.is_blank:
        return f"is blank, but {beside} beside it is not"
    reason = f"differs from {beside} in their overlap"
    for other, candidate in views.items():
        if other != number and not candidate.is_blank:
            shift = shift_by_features(candidate.features, view.features, 0.0, view.patch.px_per_rad, window_rad=math.pi)
            if shift is not None:
                fitted_deg = -math.degrees(shift.right_px / view.patch.px_per_rad)
                odometry_deg = math.degrees(wrapped_rad(yaws_rad[number] - yaws_rad[other]))
                where = f"it fits {fitted_deg:+.0f} degrees from {names[other]}, but its yaw says {odometry_deg:+.0f}"
                return f"{reason}; {where}"
    return reason


def _join_names(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _solve(
    yaws_rad: Mapping[int, float],
    ring: Ring,
    links: Links,
    unplaced: Mapping[int, str],
    views: Mapping[int, _ComparedFrame],
    given: CameraLens,
    *,
    may_be_beside: bool,
) -> FramePlacement:
    compared = next(iter(views.values())).camera
    found, places = adjust_bundle(
        given.scaled(compared.lens.width, compared.lens.height),
        compared,
        yaws_rad,
        {number: view.yaw_rad for number, view in views.items()},
        ring,
        links,
        may_be_beside=may_be_beside,
    )
    sources: dict[int, PlacedBy] = dict.fromkeys(sorted(yaws_rad), "odometry only")
    for method in ("gradients", "features"):
        sources |= {number: shift.how for pair, shift in links.items() if shift.how == method for number in pair}
    patches = {number: views[number].patch for number in sources}
    camera = found._replace(lens=found.lens.scaled(given.width, given.height))
    closing_rad = closing_error_rad(ring, links, compared.lens.focal_px)
    return FramePlacement(camera, places, sources, unplaced, closing_rad, patches)


def gains_of(placing: FramePlacement) -> dict[int, float]:
    """Return the brightness gain of each placed frame that equalises the overlaps by least squares; their mean is 1.

    Cameras adjust their exposure for each frame. A frame without usable overlaps keeps its brightness.
    """
    numbers = sorted(placing.places)
    rows: list[Floats] = []
    targets: list[float] = []
    for at, one in enumerate(numbers):
        row = np.zeros(len(numbers))
        row[at] = 1 / _GAIN_SIGMA
        rows.append(row)
        targets.append(1 / _GAIN_SIGMA)
        for beyond, other in enumerate(numbers[at + 1 :], at + 1):
            levels = _typical_levels(placing.patches, placing.places, one, other)
            if levels is not None:
                row = np.zeros(len(numbers))
                row[at], row[beyond] = levels[0] / _LEVELS_SIGMA, -levels[1] / _LEVELS_SIGMA
                rows.append(row)
                targets.append(0.0)
    gains, *_ = np.linalg.lstsq(np.array(rows), np.array(targets), rcond=None)
    return dict(zip(numbers, (gains / gains.mean()).tolist(), strict=True))


def _typical_levels(
    patches: Mapping[int, Patch], places: Mapping[int, Attitude], one: int, other: int
) -> tuple[float, float] | None:
    """Return the typical grey level of each frame in their overlap; None if the overlap is too small."""
    first, second = patches[one], patches[other]
    right_px = round(wrapped_rad(places[one].yaw_rad - places[other].yaw_rad) * first.px_per_rad)
    if abs(right_px) >= first.grey.shape[1]:
        return None
    of_first, of_second, common = _overlap(first, second, right_px)
    for colours in (of_first, of_second):
        common = common & (colours.min(axis=2) > _DARKEST) & (colours.max(axis=2) < _BRIGHTEST)
    if int(common.sum()) < _FEWEST_PX:
        return None
    level = float(of_first[common].mean())
    brighter = np.subtract(of_second[common], of_first[common], dtype=np.float32)
    return level, level + float(np.median(brighter))  # the median: a thing that only one of them shows does not count
