"""Simulated cameras above the floor: real pixels, with markers on the robots, for the plugin `tracker`."""

from __future__ import annotations

import math
import threading
import zlib
from collections.abc import Callable, Sequence
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

import numpy as np

from eal_actors.device.world import OverheadCamera
from eal_actors.plugin import FleetServices, PluginContext, PluginError

from .arena import Pose2D
from .models import Make, outline_m
from .onboard import SimulatedRobotCamera, carried_camera
from .robot import SimRobot
from .world import SimWorld, world_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .camera.looking_down import Instant, MarkerPlate, OverheadLens, OverheadRenderer

PLATE_M: Final = 0.01
"""Height of a marker over the highest part of its robot."""
_BLUR_STEP_PX: Final = 0.5
"""Way of a robot from one instant of an exposure to the next."""
_MOST_INSTANTS: Final = 16


class SimulatedOverheadCamera:
    """A camera above the floor of a simulated world.

    Args:
        name: the camera's name in the world file.
        services: names the markers on the robots.

    Thread: any; one lock.
    """

    def __init__(self, world: SimWorld, name: str, services: FleetServices) -> None:
        self._world = world
        self._camera: OverheadCamera = world.model.cameras[name]
        self._seed = zlib.crc32(name.encode())
        self._services = services
        self._lock = threading.Lock()
        self._renderer: OverheadRenderer | None = None
        self._last: tuple[NDArray[np.uint8], float] | None = None

    def frame(self) -> tuple[NDArray[np.uint8], float]:
        """Return the picture of now and the time of its exposure; the first one takes longest.

        Returns:
            Blue, green and red, shape (height, width, 3), and seconds of the fleet's clock.
        """
        with self._lock:
            renderer = self._renderer or self._start()
            with self._world.lock:
                now_s = self._world.catch_up()
                if self._last is not None and self._last[1] == now_s:
                    return self._last
                instants = self._instants()
            seed = (self._seed << 32) + round(now_s * 1e6)
            self._last = renderer.picture(instants, seed), now_s
            return self._last

    def instant_s(self) -> float:
        """Return the time that a picture of now would have."""
        with self._world.lock:
            return self._world.catch_up()

    def markers(self) -> tuple[list[tuple[int, NDArray[np.float64]]], float]:
        """Return where the camera sees whole markers now, without a picture, and the time.

        A marker behind a higher robot is hidden. There is no noise, and walls and obstacles hide nothing.

        Returns:
            Numbers and corners in pixels, (4, 2), top left first and clockwise as the print is read; seconds of the
            fleet's clock.
        """
        from .camera.looking_down import OverheadLens

        lens = OverheadLens(self._camera)
        with self._world.lock:
            now_s = self._world.catch_up()
            plates = self._plates(attrgetter("pose"))
            robots = [(*robot.pose[:2], robot.make) for robot in self._world.robots if robot.has_place]
        found = []
        for plate in (*self._floor_plates(), *plates):
            corners_m = _corners_m(plate, plate.size_m)
            rim_px = lens.project(_corners_m(plate, plate.side_m))
            if ((rim_px >= 0) & (rim_px <= np.array(lens.size) - 1)).all() and not _is_hidden(corners_m, lens, robots):
                found.append((plate.number, lens.project(corners_m)))
        return found, now_s

    def _start(self) -> OverheadRenderer:
        from .camera.looking_down import OverheadRenderer
        from .camera.shared import scene_of

        self._renderer = OverheadRenderer(scene_of(self._world), self._camera, self._floor_plates())
        return self._renderer

    def _floor_plates(self) -> list[MarkerPlate]:
        from .camera.looking_down import MarkerPlate

        marks = self._world.model.markers
        return [
            MarkerPlate(marks.family, one.id, one.size_m, one.x_m, one.y_m, 1e-4, math.radians(one.yaw_deg))
            for one in marks.floor
        ]

    def _instants(self) -> list[Instant]:
        """Return what moves, over an exposure whose middle is now. Thread: holds the world's `lock`."""
        from .camera.looking_down import Instant
        from .camera.shared import movers_of

        camera, world = self._camera, self._world
        per_m = camera.width / 2 / math.tan(math.radians(camera.fov_deg) / 2) / camera.z_m
        way_px = max((_way_m(robot) for robot in world.robots if robot.has_place), default=0.0) * per_m
        way_px *= camera.exposure_s / world.tick_s
        count = min(math.ceil(way_px / _BLUR_STEP_PX) + 1, _MOST_INSTANTS)
        found = []
        for number in range(count):
            away_s = ((number + 0.5) / count - 0.5) * camera.exposure_s
            pose_of = partial(_pose_after, ticks=away_s / world.tick_s)
            found.append(Instant(movers_of(world, pose_of=pose_of), self._plates(pose_of)))
        return found

    def _plates(self, pose_of: Callable[[SimRobot], Pose2D]) -> list[MarkerPlate]:
        """Return the markers on the robots. Thread: holds the world's `lock`."""
        from .camera.looking_down import MarkerPlate

        marks = self._world.model.markers
        plates = []
        for robot in self._world.robots:
            if (number := self._services.markers.get(robot.name)) is not None:
                x_m, y_m, yaw_rad = pose_of(robot)
                height_m = marker_height_m(robot.make)
                plates.append(MarkerPlate(marks.family, number, marks.size_m, x_m, y_m, height_m, yaw_rad))
        return plates


def _corners_m(plate: MarkerPlate, side_m: float) -> NDArray[np.float64]:
    """Return the corners of a square about the middle of a plate, (4, 3), top left first and clockwise."""
    half = side_m / 2 * np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])
    cos, sin = math.cos(plate.yaw_rad), math.sin(plate.yaw_rad)
    on_floor = half @ np.array([[cos, sin], [-sin, cos]]) + (plate.x_m, plate.y_m)
    return np.column_stack([on_floor, np.full(4, plate.z_m)])


def _is_hidden(corners_m: NDArray[np.float64], lens: OverheadLens, robots: Sequence[tuple[float, float, Make]]) -> bool:
    """Return whether a part of a robot that is higher than a marker stands between a corner of it and the camera."""
    for x_m, y_m, make in robots:
        for radius_m, top_m in outline_m(make.radius_m, make.height_m, make.camera_height_m):
            if top_m > corners_m[0, 2] and any(
                _passes(corner_m, lens, (x_m, y_m), radius_m, top_m) for corner_m in corners_m
            ):
                return True
    return False


def _passes(
    corner_m: NDArray[np.float64], lens: OverheadLens, middle: tuple[float, float], radius_m: float, top_m: float
) -> bool:
    """Return whether the ray from a corner to the camera passes through an upright cylinder below its top."""
    to_camera = lens.centre_m - corner_m
    along = to_camera[:2] * (top_m - corner_m[2]) / to_camera[2]
    away = np.array(middle) - corner_m[:2]
    way = float(np.clip(away @ along / max(float(along @ along), 1e-9), 0.0, 1.0))
    return bool(np.hypot(*(way * along - away)) < radius_m)


def _pose_after(robot: SimRobot, ticks: float) -> Pose2D:
    """Return where a robot is some ticks later, or earlier if negative, at the speed of its last tick."""
    (x0, y0, yaw0), (x1, y1, yaw1) = robot.recent_poses[1:]
    return x1 + ticks * (x1 - x0), y1 + ticks * (y1 - y0), yaw1 + ticks * (yaw1 - yaw0)


def _way_m(robot: SimRobot) -> float:
    """Return the way of the fastest point of a robot in its last tick."""
    (x0, y0, yaw0), (x1, y1, yaw1) = robot.recent_poses[1:]
    return math.hypot(x1 - x0, y1 - y0) + abs(yaw1 - yaw0) * robot.make.radius_m


def marker_height_m(make: Make) -> float:
    """Return the height of the marker on a robot of a make over the floor."""
    return outline_m(make.radius_m, make.height_m, make.camera_height_m)[-1][1] + PLATE_M


def open_camera(context: PluginContext, url: str) -> SimulatedOverheadCamera | SimulatedRobotCamera:
    """Return the camera of a URL `sim://world/<camera>`: one of the world file's `cameras`, or a robot's own.

    Raises:
        PluginError: the URL is invalid, the world has no such camera or robot, or OpenCV is not installed.
    """
    parts = urlsplit(url)
    name = parts.path.strip("/")
    if parts.netloc != "world" or not name or "/" in name or parts.query or parts.fragment:
        raise PluginError(f"camera {url!r}: a simulated camera has the form sim://world/<camera>")
    world = world_of(context.services)
    robot = world.robot_of(name)
    if name not in world.model.cameras and robot is None:
        known = ", ".join([*world.model.cameras, *(other.name for other in world.robots)]) or "none"
        raise PluginError(f"camera {url!r}: the world {world.model.name!r} has no camera {name!r}; it has: {known}")
    try:
        import cv2  # noqa: F401  # the renderer needs it
    except ImportError as error:
        raise PluginError(f"camera {url!r}: pictures need OpenCV ({error}): pip install 'eal-actors[vision]'") from None
    if name not in world.model.cameras and robot is not None:
        return carried_camera(context, world, robot)
    return SimulatedOverheadCamera(world, name, context.services)
