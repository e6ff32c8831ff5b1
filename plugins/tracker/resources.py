"""The resources of a tracker: the robots' poses, and the pictures in which they were found."""

from __future__ import annotations

import json
from collections.abc import Generator

import cv2
import numpy as np
from typing_extensions import override

from eal_actors.plugin import (
    Clock,
    DataType,
    EALData,
    Resource,
    ResourceType,
    ValueInfo,
    request,
)

from .overlay import draw
from .tracker import Tracker


class FixesSensor(Resource):
    """Poses of the robots in view, by their markers."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape=(None, 13), description="marker, x_m, y_m, yaw_rad, covariance by rows")

    def __init__(self, tracker: Tracker, clock: Clock) -> None:
        self._tracker = tracker
        self._clock = clock

    @override
    def not_ready(self) -> str | None:
        return self._tracker.why_not_ready()

    def get_status(self) -> int:
        """Return the number of present problems; the request `report` names them."""
        return len(self._tracker.problems)

    def get_value(self) -> EALData | Generator[float, None, EALData]:
        """Return a row for each robot in view, in the frame `map`, with the time of exposure.

        Raises:
            NotReadyError: no camera gives pictures, or too few floor markers are in view.
        """
        return self._tracker.after_first_picture(self._fixes)

    def _fixes(self) -> EALData:
        found = self._tracker.fixes()
        return EALData.of(found.rows(), frame_id="map", stamp_s=found.stamp_s)

    @request("report", ValueInfo(DataType.CHAR, description="JSON object: cameras, markers, problems"))
    def report(self) -> EALData:
        """Return the cameras' poses, the markers that were seen, and every problem."""
        return EALData.of(json.dumps(self._tracker.report(self._clock.now())))


class TrackedPicture(Resource):
    """The newest pictures side by side, with the found markers drawn in.

    Args:
        robot: the tracker's name in the fleet.
    """

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.CHAR, shape=(None, None, 3), description="RGB, rows from the top")

    def __init__(self, tracker: Tracker, robot: str) -> None:
        self._tracker = tracker
        self._robot = robot

    @override
    def not_ready(self) -> str | None:
        return self._tracker.why_not_ready()

    def get_value(self) -> EALData | Generator[float, None, EALData]:
        """Return the pictures, shape (height, width, 3).

        Raises:
            NotReadyError: no camera gives pictures.
        """
        return self._tracker.after_first_picture(self._picture)

    def _picture(self) -> EALData:
        cameras = self._tracker.look()
        images = [draw(camera) for camera in cameras]
        height = max(image.shape[0] for image in images)
        images = [
            np.asarray(cv2.copyMakeBorder(one, 0, height - one.shape[0], 0, 0, cv2.BORDER_CONSTANT), np.uint8)
            for one in images
        ]
        rgb = np.asarray(cv2.cvtColor(cv2.hconcat(images), cv2.COLOR_BGR2RGB), np.uint8)
        stamp_s = max(camera.stamp_s for camera in cameras if camera.stamp_s is not None)
        return EALData.of(rgb, frame_id=f"{self._robot}/picture", stamp_s=stamp_s)
