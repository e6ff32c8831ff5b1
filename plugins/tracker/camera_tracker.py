"""Follows the markers in the pictures of one camera."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Final

import cv2
import numpy as np

from eal_actors.plugin import FamilyName

from .detector import Detection, Found, MarkerDetector, SearchWindow
from .feeds import Image
from .lens import Floats, Lens
from .locating import SquareFit, fit_squares
from .mounting import LEAST_MARKERS, Mounting, MountingEstimator
from .problems import ProblemKind, ProblemList, TrackingProblem
from .settings import MarkerGroup
from .sightings import Sighting

_WHOLE_EVERY: Final = 10
"""Pictures from one search of the whole picture to the next."""
_WHOLE_AFTER_LOSS: Final = 3
"""The same while a marker is lost."""
_MIRRORED_EVERY: Final = 5
"""Whole searches from one search for mirrored markers to the next."""
_MOST_PREDICTED_S: Final = 0.4
"""Seconds after which a prediction is useless, so that the whole picture is searched."""
_MARGIN_SIDES: Final = 0.95
"""Half of a search window, in sides of the marker: half the diagonal, a white border and a little more."""
_MARGIN_PX: Final = 6.0
_SURPRISE_M_S2: Final = 3.0
"""Acceleration that a search window allows for."""
_WHOLE_KINDS: Final[tuple[ProblemKind, ...]] = ("unknown_marker", "seen_twice", "floor_marker_moved", "camera_moved")


class CameraTracker:
    """Follows markers in the pictures of one camera.

    Args:
        groups: size and height of the markers on robots, by id.
        floor: corners of the floor markers in the map frame, (4, 3), by id.
        problems: receives what is wrong.

    Attributes:
        sightings: the markers on robots in the newest picture, by id.
        detections: all markers in the newest picture.
        stamp_s: the newest picture's time of exposure; None before the first.
        picture: the newest picture; None before the first, and where the markers are known without one.

    Thread: one at a time.
    """

    def __init__(
        self,
        name: str,
        lens: Lens,
        family: FamilyName,
        groups: Mapping[int, MarkerGroup],
        floor: Mapping[int, Floats],
        problems: ProblemList,
    ) -> None:
        self.name: Final = name
        self.lens: Final = lens
        self._groups = groups
        self._floor = floor
        self._problems = problems
        self._detector = MarkerDetector(family)
        self._estimator = MountingEstimator(lens, floor)
        self.sightings: dict[int, Sighting] = {}
        self.detections: list[Detection] = []
        self.stamp_s: float | None = None
        self.picture: Image | None = None
        self.whole_searches = 0
        self._since_whole = 0
        self._lost: set[int] = set()
        self._ambiguous: set[int] = set()
        self._unknown_before: set[int] = set()

    @property
    def mounting(self) -> Mounting | None:
        """The camera's pose; None before enough floor markers were seen."""
        return self._estimator.mounting

    @property
    def floor_corners(self) -> dict[int, Floats]:
        """Where the floor markers are in the picture, (4, 2), by id; without those that are not at their places."""
        mounting = self.mounting
        used = () if mounting is None else mounting.markers
        return {one: self.lens.pixels(self._floor[one], mounting.turn, mounting.shift_m) for one in used}  # type: ignore[union-attr]

    def process(self, picture: Image, stamp_s: float) -> Found | None:
        """Find the markers in a picture, and return them; a picture that is not newer than the last one is ignored."""
        if self._is_old(stamp_s) or self._has_wrong_size(picture, stamp_s):
            return None
        found = self._search(picture, stamp_s)
        self.take(found, stamp_s)
        self.picture = picture
        return found

    def take(self, found: Found, stamp_s: float) -> None:
        """Take the markers in view that are known without a picture."""
        if self._is_old(stamp_s):
            return
        self.detections = found.detections
        if found.is_whole:
            self._learn(found.mirrored, stamp_s)
            self._note_pose(stamp_s)
        else:
            self._since_whole += 1
        self._locate(stamp_s)
        self.stamp_s, self.picture = stamp_s, None

    def _is_old(self, stamp_s: float) -> bool:
        return self.stamp_s is not None and stamp_s <= self.stamp_s

    def _search(self, picture: Image, stamp_s: float) -> Found:
        grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), np.uint8)
        windows = self._windows(stamp_s)
        if windows is not None:
            return Found(self._detector.find_around(grey, windows), is_whole=False)
        detections = self._detector.find(grey)
        is_due = self.whole_searches % _MIRRORED_EVERY == 0
        return Found(detections, is_whole=True, mirrored=self._mirrored(grey, detections) if is_due else None)

    def _has_wrong_size(self, picture: Image, stamp_s: float) -> bool:
        found, wanted = (picture.shape[1], picture.shape[0]), self.lens.size_px
        text = f"pictures of {found[0]} x {found[1]} px do not fit the lens, calibrated at {wanted[0]} x {wanted[1]} px"
        wrong = [] if found == wanted else [TrackingProblem("wrong_picture_size", self.name, None, text, stamp_s)]
        self._problems.replace(["wrong_picture_size"], self.name, wrong)
        return bool(wrong)

    def _windows(self, stamp_s: float) -> list[SearchWindow] | None:
        """Return where to search, or None for the whole picture."""
        mounting = self.mounting
        limit = _WHOLE_AFTER_LOSS if self._lost else _WHOLE_EVERY
        if mounting is None or self.stamp_s is None or not self.sightings or self._since_whole + 1 >= limit:
            return None
        if (away_s := stamp_s - self.stamp_s) > _MOST_PREDICTED_S:
            return None
        seen = list(self.sightings.values())
        groups = [self._groups[one.number] for one in seen]
        places = np.array([one.at(stamp_s)[0] for one in seen])
        places[:, 2] = [group.height_m for group in groups]
        pixels = self.lens.pixels(places, mounting.turn, mounting.shift_m)
        corners = np.stack([one.corners for one in seen])
        sides_px = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        surprises_px = _SURPRISE_M_S2 * away_s**2 / 2 * sides_px / [group.size_m for group in groups]
        halves_px = _MARGIN_SIDES * sides_px + surprises_px + _MARGIN_PX
        rows = zip(pixels.tolist(), halves_px.tolist(), sides_px.tolist(), strict=True)
        return [SearchWindow(column, row, half_px, side_px) for (column, row), half_px, side_px in rows]

    def _learn(self, mirrored: frozenset[int] | None, stamp_s: float) -> None:
        """Take from a search of the whole picture what changes rarely.

        `mirrored` are the ids of mirrored markers; None if nobody looked for them.
        """
        counts = Counter(one.number for one in self.detections)
        once = {one.number: one.corners for one in self.detections if counts[one.number] == 1}
        moves = self._estimator.moves
        self._estimator.add(once)
        if self._estimator.moves != moves:
            self.sightings.clear()  # their speeds were measured with the former pose
        self._ambiguous = {number for number, count in counts.items() if count > 1}
        # A texture rarely looks like a marker, so an unknown one counts only in two searches in a row.
        unknown = {number for number in counts if number not in self._groups and number not in self._floor}
        self._problems.replace(_WHOLE_KINDS, self.name, self._whole_problems(unknown, moves, stamp_s))
        self._unknown_before = unknown
        if mirrored is not None:
            text = "marker {} is in the picture mirrored: cover the mirror, or turn the print over"
            problems = [self._problem("mirrored", number, text.format(number), stamp_s) for number in sorted(mirrored)]
            self._problems.replace(["mirrored"], self.name, problems)
        self.whole_searches += 1
        self._since_whole = 0

    def _whole_problems(self, unknown: set[int], moves: int, stamp_s: float) -> list[TrackingProblem]:
        found = [
            self._problem("unknown_marker", number, f"marker {number} is not in the settings", stamp_s)
            for number in sorted(unknown & self._unknown_before)
        ]
        found += [
            self._problem("seen_twice", number, f"marker {number} is in the picture twice: it gets no fix", stamp_s)
            for number in sorted(self._ambiguous)
        ]
        if self.mounting is not None:
            found += [
                self._problem(
                    "floor_marker_moved",
                    number,
                    f"floor marker {number} is {away_px:.0f} px from its place: check its place in the settings",
                    stamp_s,
                )
                for number, away_px in self.mounting.wrong.items()
            ]
        if self._estimator.moves != moves:
            text = "the camera was moved: its pose is determined anew"
            found.append(TrackingProblem("camera_moved", self.name, None, text, stamp_s))
        return found

    def _mirrored(self, grey: Image, detections: Sequence[Detection]) -> frozenset[int]:
        """Return the mirrored markers, except where there is a marker: some ids are the mirror images of others."""
        places = [one.corners.mean(axis=0) for one in detections]
        mirrored = set()
        for one in self._detector.find_mirrored(grey):
            middle, side_px = one.corners.mean(axis=0), float(np.linalg.norm(one.corners[0] - one.corners[1]))
            is_known = one.number in self._groups or one.number in self._floor
            if is_known and all(np.linalg.norm(place - middle) > side_px / 2 for place in places):
                mirrored.add(one.number)
        return frozenset(mirrored)

    def _locate(self, stamp_s: float) -> None:
        """Fit the markers on robots, and remember which ones are lost."""
        former, self.sightings = self.sightings, {}
        problems: list[TrackingProblem] = []
        for one, fit in self._fits():
            if fit.misfit is not None:
                problems.append(self._problem("misfit", one.number, f"marker {one.number}: {fit.misfit}", stamp_s))
                continue
            sighting = Sighting(one.number, fit, one.corners, stamp_s, np.zeros(3))
            self.sightings[one.number] = sighting.after(former.get(one.number))
        self._problems.replace(["misfit"], self.name, problems)
        self._lost = (self._lost | set(former)) - set(self.sightings) if self._since_whole else set()

    def _fits(self) -> list[tuple[Detection, SquareFit]]:
        """Return the squares of the markers on robots, without the ambiguous ones."""
        seen = [one for one in self.detections if one.number in self._groups and one.number not in self._ambiguous]
        if self.mounting is None or not seen:
            return []
        groups = [self._groups[one.number] for one in seen]
        heights_m, sizes_m = (np.array([getattr(one, key) for one in groups]) for key in ("height_m", "size_m"))
        corners = np.stack([one.corners for one in seen])
        return list(zip(seen, fit_squares(corners, self.lens, self.mounting, heights_m, sizes_m), strict=True))

    def _note_pose(self, stamp_s: float) -> None:
        """Report a camera that does not know its pose."""
        lacking = (
            f"too few floor markers are in view: {LEAST_MARKERS} of {', '.join(map(str, self._floor))} are needed"
            if self._floor
            else "no floor markers are given: list them as `floor`, or in the world file as `markers.floor`"
        )
        problem = TrackingProblem("camera_pose_unknown", self.name, None, lacking, stamp_s)
        self._problems.replace(["camera_pose_unknown"], self.name, [] if self.mounting else [problem])

    def _problem(self, kind: ProblemKind, marker: int, text: str, stamp_s: float) -> TrackingProblem:
        return TrackingProblem(kind, self.name, marker, text, stamp_s)
