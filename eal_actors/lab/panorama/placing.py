"""Where each frame looks: as odometry says, corrected by what the frames show where they overlap."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from eal_actors.lab.panorama.cylinder import Image, Lens, Patch, patch_of, shrunk
from eal_actors.lab.panorama.features import Features, find_features, shift_by_features
from eal_actors.lab.panorama.gradients import Comparison, Slopes, compare_gradients, slopes_of
from eal_actors.lab.panorama.ring import Links, Ring, closing_error_rad, ring_of, settle
from eal_actors.lab.panorama.shift import WINDOW_RAD, How, wrapped_rad

_COMPARED_WIDTH: Final = 800
"""Frames are compared at this width at most, in pixels."""
_BLANK: Final = 2.0
"""A picture whose grey levels differ by no more than this (standard deviation) shows nothing."""
_UNLIKE: Final = 16.0
"""Grey levels by which a blank frame differs from its neighbour where they overlap, if it shows something else."""


@dataclass(frozen=True, slots=True)
class Placing:
    """Where the frames look.

    Attributes:
        places: yaw, and how far the axis is below the horizon, in radians, of each frame that was placed.
        how: what each of them was placed by.
        unplaced: why the others were not placed.
        closing_error_rad: how much more than a full turn the turns added up to; None where that is not known.
        patches: the frames that were placed, unrolled for comparing.
    """

    places: Mapping[int, tuple[float, float]]
    how: Mapping[int, How]
    unplaced: Mapping[int, str]
    closing_error_rad: float | None
    patches: Mapping[int, Patch]


def place(
    frames: Mapping[int, Image], yaws_rad: Sequence[float], field_of_view_rad: float, names: Sequence[str]
) -> Placing:
    """Find out where each frame looks.

    A frame stays where odometry has it if its overlaps show nothing to go by. It is left out if what it shows
    contradicts what every neighbour shows.

    Args:
        frames: of one size, by their numbers.
        yaws_rad: where odometry has each frame, in the order of the numbers.
        field_of_view_rad: of each frame.
        names: what the reasons call each frame.
    """
    views = {number: _View(frame, field_of_view_rad) for number, frame in frames.items()}
    if all(view.is_blank for view in views.values()):
        return Placing({}, {}, dict.fromkeys(frames, "is blank, as all of them are"), None, {})
    unplaced = _frozen(frames, yaws_rad, names)
    compared: dict[tuple[int, int], Comparison] = {}
    while True:
        left = {number: yaws_rad[number] for number in frames if number not in unplaced}
        if not left:
            return Placing({}, {}, unplaced, None, {})
        ring = ring_of(left, field_of_view_rad)
        pairs = list(ring.pairs(field_of_view_rad))
        for one, other in pairs:
            if (one, other) not in compared:
                expected_rad = wrapped_rad(yaws_rad[one] - yaws_rad[other])
                compared[one, other] = _compare(views[one], views[other], expected_rad)
        strangers = _strangers(pairs, compared)
        if not strangers:
            break
        unplaced |= {number: _why(number, strangers[number], views, yaws_rad, names) for number in sorted(strangers)}
    links = {pair: shift for pair in pairs if (shift := compared[pair].shift) is not None}
    return _settled(left, ring, links, unplaced, views)


class _View:
    """A frame as it is compared with others: each form of it is made when it is first needed."""

    def __init__(self, frame: Image, field_of_view_rad: float) -> None:
        small = shrunk(frame, _COMPARED_WIDTH)
        self.patch: Final = patch_of(small, field_of_view_rad, Lens.of(small, field_of_view_rad).focal_px)
        self.is_blank: Final = float(self.patch.grey[self.patch.reaches].std()) <= _BLANK
        self._features: Features | None = None
        self._slopes: Slopes | None = None

    @property
    def features(self) -> Features:
        if self._features is None:
            self._features = find_features(self.patch)
        return self._features

    @property
    def slopes(self) -> Slopes:
        if self._slopes is None:
            self._slopes = slopes_of(self.patch)
        return self._slopes


def _frozen(frames: Mapping[int, Image], yaws_rad: Sequence[float], names: Sequence[str]) -> dict[int, str]:
    """Return which frames are copies of an earlier one, though the camera had turned."""
    seen: dict[bytes, int] = {}
    copies: dict[int, str] = {}
    for number, frame in frames.items():
        earlier = seen.setdefault(hashlib.blake2b(np.ascontiguousarray(frame).data).digest(), number)
        turned_rad = abs(wrapped_rad(yaws_rad[number] - yaws_rad[earlier]))
        if turned_rad > WINDOW_RAD and float(frame.std()) > _BLANK:
            copies[number] = (
                f"is the same picture as {names[earlier]}, though the camera had turned by "
                f"{math.degrees(turned_rad):.0f} degrees: did it freeze?"
            )
    return copies


def _compare(first: _View, second: _View, expected_rad: float) -> Comparison:
    px_per_rad = first.patch.px_per_rad
    expected_px = expected_rad * px_per_rad
    if first.is_blank or second.is_blank:
        return Comparison(None, contradicts=_are_unlike(first.patch, second.patch, round(expected_px)))
    shift = shift_by_features(first.features, second.features, expected_px, px_per_rad)
    if shift is not None:
        return Comparison(shift, contradicts=False)
    return compare_gradients(first.slopes, second.slopes, expected_px, px_per_rad)


def _are_unlike(first: Patch, second: Patch, right_px: int) -> bool:
    """Return whether two frames differ where they overlap if the second's axis is so far to the right."""
    one, other, common = overlap(first, second, right_px)
    if not common.any():
        return False
    apart = np.abs(cv2.subtract(one, other, dtype=cv2.CV_32F))[common]
    return float(apart.mean()) > _UNLIKE


def overlap(first: Patch, second: Patch, right_px: int) -> tuple[Image, Image, np.ndarray]:
    """Return what two patches show of the same part of the cylinder, and where both reach, (h, w)."""
    width = first.grey.shape[1]
    of_first = slice(max(0, right_px), width + min(0, right_px))
    of_second = slice(max(0, -right_px), width + min(0, -right_px))
    common = first.reaches[:, of_first] & second.reaches[:, of_second]
    return first.colours[:, of_first], second.colours[:, of_second], common


def _strangers(
    pairs: Sequence[tuple[int, int]], compared: Mapping[tuple[int, int], Comparison]
) -> dict[int, list[int]]:
    """Return the frames that fit no other frame and contradict some: those."""
    fitting = {number for pair in pairs if compared[pair].shift is not None for number in pair}
    strangers: dict[int, list[int]] = {}
    for one, other in pairs:
        if compared[one, other].contradicts:
            for number, neighbour in ((one, other), (other, one)):
                if number not in fitting:
                    strangers.setdefault(number, []).append(neighbour)
    return strangers


def _why(
    number: int,
    neighbours: Sequence[int],
    views: Mapping[int, _View],
    yaws_rad: Sequence[float],
    names: Sequence[str],
) -> str:
    """Return why a frame is left out, and which frame it would fit better."""
    beside = _listed([names[neighbour] for neighbour in sorted(neighbours)])
    view = views[number]
    if view.is_blank:
        return f"is blank, but there is something to be seen in {beside} beside it"
    reason = f"shows something else than {beside} where they overlap"
    for other, candidate in views.items():
        if other != number and not candidate.is_blank:
            shift = shift_by_features(candidate.features, view.features, 0.0, view.patch.px_per_rad, window_rad=math.pi)
            if shift is not None:
                seen_deg = -math.degrees(shift.right_px / view.patch.px_per_rad)
                told_deg = math.degrees(wrapped_rad(yaws_rad[number] - yaws_rad[other]))
                return (
                    f"{reason}; it fits {seen_deg:+.0f} degrees from {names[other]}, and was said to be {told_deg:+.0f}"
                )
    return reason


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _settled(
    yaws_rad: Mapping[int, float], ring: Ring, links: Links, unplaced: Mapping[int, str], views: Mapping[int, _View]
) -> Placing:
    px_per_rad = next(iter(views.values())).patch.px_per_rad
    places = settle(yaws_rad, ring, links, px_per_rad)
    ways: dict[int, How] = dict.fromkeys(sorted(yaws_rad), "odometry only")
    for way in ("gradients", "features"):
        ways |= {number: shift.how for pair, shift in links.items() if shift.how == way for number in pair}
    patches = {number: views[number].patch for number in ways}
    return Placing(places, ways, unplaced, closing_error_rad(ring, links, px_per_rad), patches)
