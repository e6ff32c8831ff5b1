"""A tracker that sees the true poses of simulated robots with noise, one reading late: without pictures, for speed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from eal_actors import Fleet
from eal_actors.managers.config import EALConfigManager
from tests.plugin_files import write_plugin

TRACKER = """
import numpy as np
from eal_actors.plugin import *


class Settings(PluginSettingsModel):
    markers: dict[str, int]
    std_m: float = 0.002
    std_rad: float = 0.006
    silent_after_s: float | None = None
    has_nonsense: bool = False  # rows of markers that are no numbers, in an array or in a plain list


class Fixes(Resource):
    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape=(None, 13))

    def __init__(self, context):
        self.settings = context.settings
        self.world = context.services.shared("sim.world", lambda: None)
        self.random = np.random.default_rng(context.services.seed)
        self.late = None

    def get_value(self):
        with self.world.lock:
            now_s = self.world.catch_up()
            poses = {robot.name: robot.pose for robot in self.world.robots}
        if self.settings.silent_after_s is not None and now_s >= self.settings.silent_after_s:
            raise NotReadyError("the camera is unplugged")
        answer = self.late if self.late is not None else (poses, now_s)
        self.late = poses, now_s
        poses, stamp_s = answer
        std = [self.settings.std_m] * 2 + [self.settings.std_rad]
        covariance = np.diag(np.square(std)).ravel()
        rows = [
            [marker, *(np.array(poses[name]) + std * self.random.standard_normal(3)), *covariance]
            for name, marker in self.settings.markers.items()
        ]
        if self.settings.has_nonsense:
            rows += [[marker, *rows[0][1:]] for marker in (np.nan, np.inf, -1e308, 1.5)]
            if self.random.random() < 0.5:
                return EALData.of(np.ravel(rows).tolist(), frame_id="map", stamp_s=stamp_s)
        return EALData.of(np.array(rows).reshape(-1, 13), frame_id="map", stamp_s=stamp_s)


def connect(context):
    return EALPlugin("Fixes")


def disconnect(plugin):
    pass


def create_Fixes(context):
    return Fixes(context)


def destroy_Fixes(resource):
    pass
"""

TRACKED = {"from": ["odometry", "eye"]}


def tracked_fleet(
    folder: Path, robots: dict[str, Any], seed: int = 1, size_m: float | None = None, **tracker: Any
) -> Fleet:
    """Return a fleet in lock step with a tracker `eye`; it is not connected yet.

    Args:
        folder: where the plugin is written.
        robots: the other robots, with the markers 1, 2 and so on.
        seed: of the fleet.
        size_m: of a square room; None for the simulation's own.
        tracker: further settings of the tracker.
    """
    write_plugin(folder, "eye", TRACKER, "Fixes")
    markers = {name: number for number, name in enumerate(robots, start=1)}
    entries = {
        name: {"pose": {**TRACKED, "marker": markers[name]}, **entry} if "pose" not in entry else entry
        for name, entry in robots.items()
    }
    content = {
        "version": 1,
        "clock": {"rate": "max"},
        "seed": seed,
        "plugin_dirs": [folder / "plugins"],
        "robots": {"eye": {"plugins": {"eye": {"markers": markers} | tracker}}, **entries},
    }
    if size_m is not None:
        (folder / "room.yaml").write_text(f"version: 1\nname: room\nsize_m: [{size_m}, {size_m}]\n", encoding="utf-8")
        content["world"] = str(folder / "room.yaml")
    return Fleet(EALConfigManager.of(content, name="tracked").fleet)
