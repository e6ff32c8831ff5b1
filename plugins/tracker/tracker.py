"""The tracker: all cameras, their fusion, and the report."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Collection, Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from eal_actors.plugin import EALData, FamilyName, FloorMarker, NotReadyError, get_logger

from .camera_tracker import CameraTracker
from .feeds import PictureFeed
from .lens import Floats, Lens
from .locating import square_corners
from .problems import ProblemList, TrackingProblem
from .settings import MarkerGroup
from .sightings import Sighting, fuse

_LOOK_S: Final = 0.02  # between two looks for a first picture
_LATE_S: Final = 0.2
"""Seconds by which a camera's picture may be older than the newest one."""
_UNSEEN_S: Final = 0.5
"""Seconds without a sight of a marker after which this is reported."""


@dataclass(frozen=True)
class Fix:
    """The pose of a robot by its marker.

    Attributes:
        pose: x_m, y_m and yaw_rad of the robot in the map frame, (3,).
        covariance: of the pose, (3, 3).
        cameras: the cameras that see the marker.
    """

    marker: int
    pose: Floats
    covariance: Floats
    cameras: tuple[str, ...]


@dataclass(frozen=True)
class Fixes:
    """The poses of all robots in view at one time of exposure."""

    stamp_s: float
    fixes: tuple[Fix, ...]

    def rows(self) -> Floats:
        """Return marker id, pose and covariance of each, (n, 13)."""
        rows = [np.concatenate([[fix.marker], fix.pose, fix.covariance.ravel()]) for fix in self.fixes]
        return np.array(rows).reshape(-1, 13)


class Tracker:
    """Finds the robots in the pictures of its cameras.

    The newest pictures are processed when somebody asks for fixes, so that nothing works in the background.

    Args:
        robot: the tracker's name in the fleet, for the log.
        groups: the markers on robots.
        floor: the markers on the floor.
        carried: the markers that robots of the fleet carry, to be reported while out of view; all of `groups` if empty.

    Attributes:
        cameras: what each camera sees, by name.

    Thread: any; one lock.
    """

    def __init__(
        self,
        robot: str,
        family: FamilyName,
        groups: Sequence[MarkerGroup],
        floor: Sequence[FloorMarker],
        carried: Collection[int] = (),
    ) -> None:
        self._family: FamilyName = family
        self._log = get_logger(robot=robot, resource="Fixes")
        self._groups: Mapping[int, MarkerGroup] = {number: group for group in groups for number in group.ids}
        self._expected = [number for number in self._groups if not carried or number in carried]
        self._floor = {marker.id: _corners_on_floor(marker) for marker in floor}
        self._problems = ProblemList(self._log_problem)
        self._feeds: dict[str, PictureFeed] = {}
        self._live: set[str] = set()
        self._seen_s: dict[int, float] = {}
        self._begun_s: float | None = None
        self._lock = threading.Lock()
        self.cameras: dict[str, CameraTracker] = {}

    def add_camera(self, name: str, lens: Lens, feed: PictureFeed) -> None:
        """Add a camera, before the first fixes."""
        self._feeds[name] = feed
        self.cameras[name] = CameraTracker(name, lens, self._family, self._groups, self._floor, self._problems)

    def close(self) -> None:
        """Close the cameras."""
        for feed in self._feeds.values():
            feed.close()

    def why_not_ready(self) -> str | None:
        """Return why no camera gives pictures; None if one does."""
        reasons = [feed.why_not_ready() for feed in self._feeds.values()]
        return None if None in reasons else "; ".join(filter(None, reasons))

    def after_first_picture(self, value: Callable[[], EALData]) -> EALData | Generator[float, None, EALData]:
        """Return a value, or an activity that returns it once a camera has given its first picture or has failed."""

        def wait() -> Generator[float, None, EALData]:
            while self._awaits_first():
                yield _LOOK_S
            return value()

        return wait() if self._awaits_first() else value()

    def _awaits_first(self) -> bool:
        return all(feed.awaits_first for feed in self._feeds.values())

    def fixes(self) -> Fixes:
        """Return the poses in the newest pictures.

        Raises:
            NotReadyError: no camera gives pictures, or no camera knows its pose.

        Thread: blocks the caller for the search of new pictures: some 5 ms, or 20 ms for whole pictures.
        """
        with self._lock:
            self._update()
            ready = [
                camera
                for name, camera in self.cameras.items()
                if name in self._live and camera.stamp_s is not None and camera.mounting
            ]
            if not ready:
                raise self._no_picture()
            newest_s = max(camera.stamp_s for camera in ready if camera.stamp_s is not None)
            return Fixes(newest_s, self._fused(ready, newest_s))

    def report(self, now_s: float) -> dict[str, Any]:
        """Return the cameras' poses, the markers in view and the problems, for JSON."""
        with self._lock:
            self._update()
            cameras = {name: _camera_as_json(camera) for name, camera in self.cameras.items()}
            seen = {
                str(number): {"seen_s": round(stamp_s, 6), "age_s": round(max(now_s - stamp_s, 0.0), 6)}
                for number, stamp_s in sorted(self._seen_s.items())
            }
            problems = [one.as_json() for one in self._problems.present]
        return {"cameras": cameras, "markers": seen, "problems": problems}

    @property
    def problems(self) -> tuple[TrackingProblem, ...]:
        """The present problems. Thread: any."""
        with self._lock:
            return self._problems.present

    def look(self, *, placed: bool = False) -> tuple[CameraTracker, ...]:
        """Process the newest pictures and return the cameras that have one, and with `placed` know their pose.

        Raises:
            NotReadyError: there is none.
        """
        with self._lock:
            self._update()
            for name, camera in self.cameras.items():
                if camera.stamp_s is not None and camera.picture is None:
                    camera.picture, _ = self._feeds[name].newest()
            found = [one for one in self.cameras.values() if one.picture is not None and (one.mounting or not placed)]
            if not found:
                raise self._no_picture()
            return tuple(found)

    def _no_picture(self) -> NotReadyError:
        return NotReadyError("; ".join(one.text for one in self._problems.present) or "no picture yet")

    def _update(self) -> None:
        """Process the newest picture of each camera. Thread: holds the lock."""
        for name, feed in self._feeds.items():
            camera = self.cameras[name]
            self._live.add(name)
            try:
                known = feed.known()
                picture, stamp_s = feed.newest() if known is None else (None, known[1])
            except NotReadyError as error:
                self._live.discard(name)
                failed = [TrackingProblem("camera_not_ready", name, None, error.message, camera.stamp_s or 0.0)]
                self._problems.replace(["camera_not_ready"], name, failed)
                continue
            self._problems.replace(["camera_not_ready"], name, [])
            found = None
            if known is not None and stamp_s != camera.stamp_s:
                found, _ = known
                camera.take(found, stamp_s)
            elif picture is not None:
                found = camera.process(picture, stamp_s)
            if found is not None:
                feed.note(found, stamp_s)
            if self._begun_s is None:
                self._begun_s = stamp_s
            self._seen_s |= dict.fromkeys(camera.sightings, stamp_s)
        self._note_unseen()

    def _note_unseen(self) -> None:
        stamps = [camera.stamp_s for camera in self.cameras.values() if camera.stamp_s is not None]
        if not stamps or self._begun_s is None:
            return
        now_s, problems = max(stamps), []
        for number in self._expected:
            last_s = self._seen_s.get(number, self._begun_s)
            if now_s - last_s > _UNSEEN_S:
                where = "is hidden or out of view" if number in self._seen_s else "has never been in view"
                text = f"marker {number} {where}"
                problems.append(TrackingProblem("not_seen", "", number, text, last_s))
        self._problems.replace(["not_seen"], "", problems)

    def _fused(self, cameras: Sequence[CameraTracker], stamp_s: float) -> tuple[Fix, ...]:
        seen: dict[int, list[tuple[str, Sighting]]] = {}
        for camera in cameras:
            for number, sighting in camera.sightings.items():
                if stamp_s - sighting.stamp_s <= _LATE_S:
                    seen.setdefault(number, []).append((camera.name, sighting))
        fixes, problems = [], []
        for number, by_camera in sorted(seen.items()):
            names = tuple(name for name, _ in by_camera)
            fused = fuse([sighting for _, sighting in by_camera], stamp_s)
            if fused is None:
                text = f"cameras {' and '.join(names)} disagree on marker {number}, which gets no fix: check the floor"
                problems.append(TrackingProblem("cameras_disagree", "", number, text, stamp_s))
                continue
            fixes.append(Fix(number, *_of_robot(*fused, self._groups[number]), names))
        self._problems.replace(["cameras_disagree"], "", problems)
        return tuple(fixes)

    def _log_problem(self, problem: TrackingProblem) -> None:
        about = {"camera": problem.camera} if problem.camera else {}
        self._log.warning(problem.text, kind=problem.kind, **about)


def _corners_on_floor(marker: FloorMarker) -> Floats:
    """Return the corners of a floor marker in the map frame, (4, 3)."""
    yaw_rad = math.radians(marker.yaw_deg)
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    corners = square_corners(marker.size_m) @ np.array([[cos, sin], [-sin, cos]]) + (marker.x_m, marker.y_m)
    return np.column_stack([corners, np.zeros(4)])


def _of_robot(pose: Floats, covariance: Floats, group: MarkerGroup) -> tuple[Floats, Floats]:
    """Return the pose of the robot that carries a marker, and its covariance."""
    yaw_rad = math.remainder(pose[2] - math.radians(group.yaw_deg), math.tau)
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    away_x, away_y = cos * group.ahead_m - sin * group.left_m, sin * group.ahead_m + cos * group.left_m
    slope = np.array([[1.0, 0.0, away_y], [0.0, 1.0, -away_x], [0.0, 0.0, 1.0]])
    return np.array([pose[0] - away_x, pose[1] - away_y, yaw_rad]), slope @ covariance @ slope.T


def _camera_as_json(camera: CameraTracker) -> dict[str, Any]:
    mounting = camera.mounting
    return {
        "stamp_s": camera.stamp_s,
        "markers": sorted(camera.sightings),
        "place_m": None if mounting is None else [round(float(part), 4) for part in mounting.centre_m],
        "error_px": None if mounting is None else round(mounting.error_px, 3),
        "floor_markers": [] if mounting is None else list(mounting.markers),
    }
