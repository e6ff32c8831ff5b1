"""A camera that turns in the laboratory, the ideal panorama of its frames, and a measure of similarity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from eal_actors.device.world import load_world
from eal_actors.lab.panorama import Panorama, stitching
from eal_actors.lab.panorama.cylinder import Attitude, CameraLens, wrapped_rad
from eal_actors.lab.panorama.placement import place_frames
from plugins.sim.camera.eye import Eye, PinholeLens
from plugins.sim.camera.movers import Mover
from plugins.sim.camera.render import render
from plugins.sim.camera.scene import Scene
from tests.unit.plugins.sim import ray_caster

LAB = Path(__file__).parents[4] / "fleets" / "worlds" / "lab.yaml"
PLACE_M = 0.3, -0.2, 0.35
STEP_RAD = math.radians(45)
VIEW_RAD = math.radians(60)

Image = NDArray[np.uint8]


@cache
def lab() -> Scene:
    return Scene(load_world(LAB))


def shots(
    yaws_rad: Sequence[float], width: int = 320, view_rad: float = VIEW_RAD, scene: Scene | None = None
) -> list[Image]:
    """Return what the camera sees at each yaw."""
    lens = PinholeLens(width, width * 3 // 4, math.degrees(view_rad))
    return [render(scene or lab(), [], Eye(*PLACE_M, yaw_rad, lens)) for yaw_rad in yaws_rad]


def shots_beside(yaws_rad: Sequence[float], ahead_m: float, left_m: float, width: int = 320) -> list[Image]:
    """Return what a camera beside the axis of rotation sees at each yaw."""
    lens, (x_m, y_m, z_m) = PinholeLens(width, width * 3 // 4, math.degrees(VIEW_RAD)), PLACE_M
    eyes = (
        Eye(
            x_m + ahead_m * math.cos(yaw_rad) - left_m * math.sin(yaw_rad),
            y_m + ahead_m * math.sin(yaw_rad) + left_m * math.cos(yaw_rad),
            z_m,
            yaw_rad,
            lens,
        )
        for yaw_rad in yaws_rad
    )
    return [render(lab(), [], eye) for eye in eyes]


def steps(number: int = 8, step_rad: float = STEP_RAD) -> list[float]:
    """Return the yaws of a robot that turns right."""
    return [-step * step_rad for step in range(number)]


def noisy(yaws_rad: Sequence[float], seed: int, sigma_deg: float = 2.0) -> list[float]:
    """Return the yaws of a robot that meant to turn to these, with random errors."""
    errors = np.random.default_rng(seed).normal(0.0, math.radians(sigma_deg), len(yaws_rad))
    return [yaw_rad + float(error) for yaw_rad, error in zip(yaws_rad, errors, strict=True)]


def mean_error_rad(panorama: Panorama, true_rad: Sequence[float]) -> float:
    """Return by how much the whole panorama is turned, which no picture can tell."""
    return float(np.mean([wrapped_rad(yaw_rad - true) for yaw_rad, true in _both(panorama, true_rad)]))


def yaw_error_rad(panorama: Panorama, true_rad: Sequence[float]) -> float:
    """Return how wrong the yaws are besides, root mean square."""
    turned_rad = mean_error_rad(panorama, true_rad)
    return math.sqrt(
        np.mean([wrapped_rad(yaw_rad - true - turned_rad) ** 2 for yaw_rad, true in _both(panorama, true_rad)])
    )


def truth(panorama: Panorama, true_rad: Sequence[float], rays_per_side: int = 2, movers: Sequence[Mover] = ()) -> Image:
    """Return what a perfect panorama shows in place of this one, ray by ray."""
    height, width = panorama.image.shape[:2]
    left_rad = panorama.left_yaw_rad - mean_error_rad(panorama, true_rad)
    surfaces = list(ray_caster._surfaces(lab(), movers))
    parts = (np.arange(rays_per_side) + 0.5) / rays_per_side
    total = np.zeros((height, width, 3))
    for part_x in parts:
        yaws_rad = left_rad - (np.arange(width) + part_x) / panorama.px_per_rad
        for part_y in parts:
            down = (np.arange(height) + part_y - panorama.horizon_px) / panorama.px_per_rad
            directions = np.empty((height, width, 3))
            directions[..., 0], directions[..., 1] = np.cos(yaws_rad), np.sin(yaws_rad)
            directions[..., 2] = -down[:, np.newaxis]
            colours = ray_caster._colours(surfaces, np.array(PLACE_M), directions.reshape(-1, 3))
            total += colours.reshape(total.shape)
    return np.rint(total / rays_per_side**2).clip(0, 255).astype(np.uint8)


def true_nearness(yaws_rad: NDArray[Any], down: NDArray[Any]) -> NDArray[np.float64]:
    """Return the inverse horizontal distance of what is seen from the axis, in camera heights, (h, w)."""
    directions = np.empty((len(down), len(yaws_rad), 3))
    directions[..., 0], directions[..., 1] = np.cos(yaws_rad), np.sin(yaws_rad)
    directions[..., 2] = -down[:, np.newaxis]
    rays = directions.reshape(-1, 3)
    met = [surface.meet(np.array(PLACE_M), rays) for surface in ray_caster._surfaces(lab(), [])]
    return np.asarray(PLACE_M[2] / np.min(met, axis=0)).reshape(len(down), -1)


def ssim(image: Image, other: Image) -> float:
    """Return the structural similarity of two pictures' brightness (Wang et al. 2004), in windows of 1.5 px sigma."""
    one, two = (cv2.cvtColor(each, cv2.COLOR_RGB2GRAY).astype(np.float64) for each in (image, other))

    def mean(array: Any) -> NDArray[np.float64]:
        return np.asarray(cv2.GaussianBlur(array, (11, 11), 1.5))

    mean_one, mean_two = mean(one), mean(two)
    power = mean(one * one) - mean_one**2 + mean(two * two) - mean_two**2
    common = mean(one * two) - mean_one * mean_two
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    alike = (2 * mean_one * mean_two + c1) * (2 * common + c2)
    return float((alike / ((mean_one**2 + mean_two**2 + c1) * (power + c2))).mean())


def by_odometry_alone(frames: Sequence[Image], yaws_rad: Sequence[float], view_rad: float = VIEW_RAD) -> Panorama:
    """Return the panorama that needs no look at the frames' contents, but for their brightness."""
    numbered = dict(enumerate(frames))
    names = [f"frame {number}" for number in numbered]
    placement = place_frames(numbered, yaws_rad, CameraLens.of(frames[0], view_rad), names)
    places = {number: Attitude(yaw_rad) for number, yaw_rad in enumerate(yaws_rad)}
    return stitching._render(numbered, replace(placement, places=places), {}, len(frames))


def _both(panorama: Panorama, true_rad: Sequence[float]) -> list[tuple[float, float]]:
    return [(yaw, true) for yaw, true in zip(panorama.yaws_rad, true_rad, strict=True) if yaw is not None]
