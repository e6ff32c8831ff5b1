"""A simulated arena with robots that carry markers, an overhead camera, and a tracker with its own detector."""

from __future__ import annotations

import math
import random
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eal_actors.device.world import WorldModel
from eal_actors.plugin import FleetServices, PluginContext
from plugins.sim.models import MAKES, MakeName
from plugins.sim.overhead import marker_height_m
from plugins.sim.plugin import open_camera
from plugins.sim.robot import SimRobot
from plugins.sim.world import SimWorld, world_of
from plugins.tracker import plugin as tracker_plugin
from plugins.tracker.feeds import PictureFeed
from plugins.tracker.tracker import Fix, Fixes, Tracker
from tests.manual_clock import ManualClock

MAKE_NAMES: tuple[MakeName, ...] = ("evbot2", "evbot3", "roomba")
FLOOR = [(40, -1.75, -1.3), (41, 1.75, -1.3), (42, 1.75, 1.3), (43, -1.75, 1.3), (44, 0.0, 1.35), (45, 0.0, -1.35)]
DISTORTION = (-0.2, 0.05, 0.001, -0.001, 0.0)
CEILING: dict[str, Any] = {
    "y_m": -0.3,
    "z_m": 3.4,
    "tilt_deg": 6.0,
    "fov_deg": 66.0,
    "distortion": DISTORTION,
    "noise": 4.0,
    "blur_px": 0.7,
}
STEP_S = 1 / 30


def world_model(cameras: dict[str, dict[str, Any]] | None = None, **parts: Any) -> WorldModel:
    floor = [{"id": number, "x_m": x_m, "y_m": y_m, "size_m": 0.2} for number, x_m, y_m in FLOOR]
    fields = {
        "version": 1,
        "name": "arena",
        "size_m": (4.6, 3.6),
        "height_m": 3.6,
        "textures": {"planks": {"pattern": "planks", "colours": [[170, 130, 85], [150, 112, 70]], "tile_m": 0.2}},
        "surfaces": {"floor": "planks"},
        "markers": {"size_m": 0.12, "floor": floor},
        "cameras": cameras or {"ceiling": CEILING},
        **parts,
    }
    return WorldModel.model_validate(fields)


def lens_of(camera: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """Return the true lens of a simulated camera, as settings."""
    width, height = camera.get("width", 1280), camera.get("height", 960)
    focal_px = width / 2 / math.tan(math.radians(camera["fov_deg"]) / 2)
    centre = ((width - 1) / 2, (height - 1) / 2)
    lens = {"size_px": (width, height), "focal_px": (focal_px, focal_px), "centre_px": centre}
    return {**lens, "distortion": camera.get("distortion", (0.0,) * 5), **changes}


class Arena:
    """A world with robots and a tracker. The clock moves only by `step`.

    Args:
        count: number of robots; robot number n carries marker n.
        seed: of their paths.
        model: the world.
        settings: of the tracker, instead of the defaults.
    """

    def __init__(self, count: int = 6, seed: int = 1, model: WorldModel | None = None, **settings: Any) -> None:
        self.clock = ManualClock()
        self.model = model or world_model()
        self.services = FleetServices(self.clock, seed, self.model, open_camera=open_camera)
        self.services.markers = {f"robot-{number}": number for number in range(count)}
        self.world: SimWorld = world_of(self.services)
        self.random = random.Random(seed)  # noqa: S311  # paths
        self.robots = [self._join(number, count) for number in range(count)]
        cameras = {
            name: {"source": f"sim://world/{name}", "lens": lens_of(camera.model_dump())}
            for name, camera in self.model.cameras.items()
        }
        fields = {"cameras": cameras, "markers": groups(count), **settings}
        context = PluginContext("cameras-1", "tracker", tracker_plugin.Settings.model_validate(fields), self.services)
        self.plugin = tracker_plugin.connect(context)
        self.tracker: Tracker = self.plugin.tracker

    def _join(self, number: int, count: int) -> SimRobot:
        columns = math.ceil(math.sqrt(count * 4 / 3))
        rows = math.ceil(count / columns)
        x_m = ((number % columns) - (columns - 1) / 2) * 3.5 / columns
        y_m = ((number // columns) - (rows - 1) / 2) * 2.6 / rows
        start = x_m, y_m, self.random.uniform(-math.pi, math.pi)
        return self.world.join(f"robot-{number}", make_of(number), noise=True, start=start)

    def camera(self, name: str) -> PictureFeed:
        """Return where the pictures of a camera come from."""
        return self.tracker._feeds[name]

    def drive(self) -> None:
        """Drive every robot on a small circle."""
        with self.world.lock:
            self.world.catch_up()
            for robot in self.robots:
                radius_m, turn_rad_s = self.random.uniform(0.02, 0.09), self.random.choice((-1.5, 1.5))
                half_m = robot.make.track_m / 2
                speed_m_s = radius_m * abs(turn_rad_s)
                self.world.drive(robot, speed_m_s - turn_rad_s * half_m, speed_m_s + turn_rad_s * half_m)

    def drive_straight(self, speed_m_s: float) -> None:
        """Drive every robot ahead, at a constant speed within a third of a second."""
        with self.world.lock:
            self.world.catch_up()
            for robot in self.robots:
                x_m, y_m, yaw_rad = robot.pose
                self.world.carry(robot, (x_m - 0.1 * math.cos(yaw_rad), y_m - 0.1 * math.sin(yaw_rad), yaw_rad))
                self.world.drive(robot, speed_m_s, speed_m_s)

    def step(self, duration_s: float = STEP_S) -> Fixes:
        self.clock.advance(duration_s)
        return self.tracker.fixes()

    def truth(self) -> dict[int, tuple[float, float, float]]:
        with self.world.lock:
            self.world.catch_up()
            return {number: robot.pose for number, robot in enumerate(self.robots)}

    def errors(self, fixes: Fixes) -> NDArray[np.float64]:
        """Return x, y and yaw of each fix minus the truth now, (n, 3)."""
        truth = self.truth()
        return np.array([difference(fix, truth[fix.marker]) for fix in fixes.fixes]).reshape(-1, 3)

    def kinds(self) -> dict[str, list[int | None]]:
        """Return the present problems' markers by kind."""
        return kinds_of(self.tracker)


def kinds_of(tracker: Tracker) -> dict[str, list[int | None]]:
    """Return the markers of a tracker's present problems by kind."""
    found: dict[str, list[int | None]] = {}
    for problem in tracker.problems:
        found.setdefault(problem.kind, []).append(problem.marker)
    return found


def difference(fix: Fix, pose: Iterable[float]) -> NDArray[np.float64]:
    away = fix.pose - np.array(list(pose))
    away[2] = math.remainder(away[2], math.tau)
    return np.asarray(away)


def make_of(number: int) -> Any:
    return MAKES[MAKE_NAMES[number % 3]]


def groups(count: int, size_m: float = 0.12) -> list[dict[str, Any]]:
    """Return the settings of the markers on robots of each make."""
    found = []
    for place, name in enumerate(MAKE_NAMES):
        ids = list(range(place, count, 3))
        if ids:
            found.append({"ids": ids, "size_m": size_m, "height_m": marker_height_m(MAKES[name])})
    return found


__all__ = ["Arena", "difference", "groups", "lens_of", "make_of", "world_model"]
