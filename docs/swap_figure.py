"""Make the picture and the film of twenty robots that swap places: `make figures`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from eal_actors.device.world import WorldModel
from eal_actors.recording.arena import draw_arena, draw_grid, new_figure
from eal_actors.recording.picture import COLOURS, MARKERS
from eal_actors.testing import Simulation

RADII_M: Final = {"evbot2": 0.18, "evbot3": 0.20, "roomba": 0.17}
PILLARS: Final = ((-0.2, 1.4), (0.3, 0.45), (-0.4, -0.6), (0.2, -1.7))
FIX_S: Final = 0.1
_FRAME_FIXES: Final = 6
_SCALE: Final = 70  # pixels in a metre
_SIDE_M: Final = 6.0

Pose = tuple[float, float, float]


def drive_swap() -> tuple[dict[str, str], list[dict[str, Pose]], WorldModel]:
    """Let the robots swap sides; return their models, their true poses every `FIX_S`, and the world."""
    models, robots, goals = {}, {}, {}
    for number in range(20):
        name, model = f"r{number:02}", list(RADII_M)[number % 3]
        column, row = divmod(number % 10, 5)
        side = -1 if number < 10 else 1
        models[name] = model
        robots[name] = {"model": model, "start": (side * (2.45 - 0.8 * column), row - 2.0, 90.0)}
        goals[name] = (-side * (2.45 - 0.8 * column), 2.0 - row)
    pillars = [{"kind": "circle", "x_m": x_m, "y_m": y_m, "radius_m": 0.15} for x_m, y_m in PILLARS]
    room = {"version": 1, "name": "swap", "size_m": [_SIDE_M, _SIDE_M], "obstacles": pillars}
    trail = []
    with Simulation(robots, room, seed=7) as simulation:
        journey = simulation.fleet.go_to(goals)
        while not journey.done():
            poses = {name: simulation.pose(name) for name in robots}
            for name, (x_m, y_m, yaw_rad) in poses.items():  # as a tracker above the floor does
                simulation[name].pose.set(x_m, y_m, math.degrees(yaw_rad))
            trail.append({name: (*pose,) for name, pose in poses.items()})
            simulation.advance(FIX_S)
        journey.get()
        world = simulation.fleet.config.world
    if world is None:
        raise RuntimeError("the simulation has no world")
    return models, trail, world


def draw_swap(folder: Path) -> None:
    """Draw `swap.png` and `swap.gif`."""
    models, trail, world = drive_swap()
    colours = {name: COLOURS[number % len(COLOURS)] for number, name in enumerate(models)}
    figure = new_figure(6.4, 6.6)
    if figure is None:
        raise RuntimeError("matplotlib is missing")
    axes = figure.subplots()
    draw_arena(axes, world)
    for number, (name, colour) in enumerate(colours.items()):
        xs, ys, _ = zip(*(poses[name] for poses in trail), strict=True)
        marker = MARKERS[(number + number // len(COLOURS)) % len(MARKERS)]
        axes.plot(xs, ys, "-" if number < len(models) / 2 else "--", color=colour, linewidth=1.4)
        axes.plot(xs[0], ys[0], marker, color=colour, markersize=7, markerfacecolor="white")
        axes.plot(xs[-1], ys[-1], marker, color=colour, markersize=7)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    draw_grid(axes)
    axes.set_title(f"twenty robots swap sides in {len(trail) * FIX_S:.0f} s: from the hollow marks to the filled")
    figure.savefig(folder / "swap.png", metadata={"Software": None})
    frames = [_frame(poses, models, colours) for poses in [*trail[::_FRAME_FIXES], *[trail[-1]] * 20]]
    images = [Image.fromarray(frame).quantize(64, dither=Image.Dither.NONE) for frame in frames]
    images[0].save(folder / "swap.gif", save_all=True, append_images=images[1:], duration=60, loop=0, optimize=True)


def _frame(poses: dict[str, Pose], models: dict[str, str], colours: dict[str, str]) -> NDArray[np.uint8]:
    side_px = round(_SIDE_M * _SCALE)
    frame = np.full((side_px, side_px, 3), 255, np.uint8)
    for x_m, y_m in PILLARS:
        cv2.circle(frame, _pixel(x_m, y_m), round(0.15 * _SCALE), (150, 150, 150), -1, cv2.LINE_AA)
    for name, (x_m, y_m, yaw_rad) in poses.items():
        colour = tuple(bytes.fromhex(colours[name][1:]))
        radius_m = RADII_M[models[name]]
        cv2.circle(frame, _pixel(x_m, y_m), round(radius_m * _SCALE), colour, -1, cv2.LINE_AA)
        nose = _pixel(x_m + radius_m * math.cos(yaw_rad), y_m + radius_m * math.sin(yaw_rad))
        cv2.line(frame, _pixel(x_m, y_m), nose, (255, 255, 255), 2, cv2.LINE_AA)
    return frame


def _pixel(x_m: float, y_m: float) -> tuple[int, int]:
    return round((x_m + _SIDE_M / 2) * _SCALE), round((_SIDE_M / 2 - y_m) * _SCALE)
