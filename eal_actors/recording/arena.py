"""Plan of an arena, alone or below the robots' paths; and the empty figure of every picture."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from eal_actors.device.world import Beacon, BoxObstacle, CircleObstacle, Drop, MovableBox, WorldModel
from eal_actors.kernel.log import get_logger

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

_Style: TypeAlias = dict[str, Any]

_OBSTACLE: Final[_Style] = {"facecolor": "#d9d9d9", "edgecolor": "#7f7f7f"}
_BOX: Final[_Style] = {"facecolor": "#f3e3c3", "edgecolor": "#8a6d3b", "linestyle": (0, (3, 1.5))}
_DROP: Final[_Style] = {"facecolor": "white", "edgecolor": "#9a9a9a", "hatch": "////"}
_KEEP_OUT: Final[_Style] = {"facecolor": "#f7d4d0", "edgecolor": "#b3392c", "hatch": "xx", "alpha": 0.55}
_PLACE: Final[_Style] = {
    "linestyle": "",
    "marker": "P",
    "markersize": 8,
    "color": "#0072b2",
    "markeredgecolor": "white",
}
_POSTER: Final[_Style] = {"color": "#8c7bb8", "linewidth": 6, "solid_capstyle": "butt"}
_BEACON: Final[_Style] = {"linestyle": "", "marker": "o", "markersize": 9, "markeredgecolor": "black"}
_LAMP_COLOURS: Final[_Style] = {"color": "#ffd75e", "markeredgecolor": "#a88600"}
_LAMP: Final[_Style] = {"linestyle": "", "marker": "*", "markersize": 13, **_LAMP_COLOURS}
_START: Final[_Style] = {"linestyle": "", "marker": "o", "markersize": 3.5, "color": "#b0b0b0"}
_MOST_NUMBERED: Final = 100
"""With more numbers than this, they hide the plan."""


def new_figure(width_in: float, height_in: float) -> Figure | None:
    """Return an empty figure of a size in inches, or None when matplotlib is not installed, which is logged."""
    if importlib.util.find_spec("matplotlib") is None:
        get_logger().warning("no picture: matplotlib is missing", remedy="pip install 'eal-actors[sim]'")
        return None
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def draw_grid(axes: Axes) -> None:
    """Draw thin lines at the ticks, below everything else."""
    axes.grid(visible=True, color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)


def draw_world(world: WorldModel, out: Path) -> Path | None:
    """Draw a world's plan: obstacles and start poses with their numbers from 0, other things with their names.

    The suffix of the file selects its format, such as `.png` or `.svg`. Without matplotlib, which is logged, the result
    is None.
    """
    width_m, depth_m = world.size_m
    figure = new_figure(9.0, min(max(8.0 * depth_m / width_m, 3.0), 16.0))
    if figure is None:
        return None
    axes = figure.subplots()
    draw_arena(axes, world)
    for lamp in world.lighting.lamps:
        axes.plot([lamp.x_m], [lamp.y_m], **_LAMP)
    _write_names(axes, world)
    axes.set_title(f"{world.name}: {width_m:g} x {depth_m:g} m, {world.height_m:g} m high", loc="left", fontsize=12)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    draw_grid(axes)
    if handles := _legend(world):
        axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)
    figure.savefig(out, bbox_inches="tight")
    return out


def draw_arena(axes: Axes, world: WorldModel) -> None:
    """Draw the arena at its start, and fit the limits of the axes to it.

    Obstacles are grey; drops are hatched; boxes have dashed edges; beacons are dots of their colours; posters are
    strips on their walls; keep-out zones are hatched in red; places are crosses; a dot with a line is a start pose
    with its heading.
    """
    from matplotlib.patches import Circle, Polygon, Rectangle

    width_m, depth_m = world.size_m
    axes.add_patch(Rectangle((-width_m / 2, -depth_m / 2), width_m, depth_m, fill=False, linewidth=2.5))
    for drop in world.drops:
        axes.add_patch(_rectangle(drop, _DROP))
    for zone in world.keep_out:
        axes.add_patch(Polygon(zone, **_KEEP_OUT))
    for obstacle in world.solid_obstacles:
        if isinstance(obstacle, CircleObstacle):
            axes.add_patch(Circle((obstacle.x_m, obstacle.y_m), obstacle.radius_m, **_OBSTACLE))
        else:
            axes.add_patch(_rectangle(obstacle, _OBSTACLE))
    for box in world.boxes:
        axes.add_patch(_rectangle(box, _BOX))
    for poster in world.posters:
        axes.plot(*zip(*poster.ends_m(world.size_m), strict=True), **_POSTER)
    _draw_starts(axes, world)
    for beacon in world.beacons:
        axes.plot([beacon.x_m], [beacon.y_m], color=[channel / 255 for channel in beacon.colour], **_BEACON)
    for place in world.places.values():
        axes.plot([place.x_m], [place.y_m], **_PLACE)
    margin_m = 0.05 * max(width_m, depth_m)
    axes.set_xlim(-width_m / 2 - margin_m, width_m / 2 + margin_m)
    axes.set_ylim(-depth_m / 2 - margin_m, depth_m / 2 + margin_m)


def _rectangle(thing: BoxObstacle | MovableBox | Drop, style: _Style) -> Patch:
    from matplotlib.patches import Rectangle

    along_m, across_m = thing.size_m
    corner = (thing.x_m - along_m / 2, thing.y_m - across_m / 2)
    return Rectangle(corner, along_m, across_m, angle=thing.yaw_deg, rotation_point="center", **style)


def _draw_starts(axes: Axes, world: WorldModel) -> None:
    length_m = 0.03 * max(world.size_m)
    poses = world.start_poses
    axes.plot([pose.x_m for pose in poses], [pose.y_m for pose in poses], **_START)
    for pose in poses:
        yaw_rad = math.radians(pose.yaw_deg)
        ahead = [pose.x_m, pose.x_m + length_m * math.cos(yaw_rad)], [pose.y_m, pose.y_m + length_m * math.sin(yaw_rad)]
        axes.plot(*ahead, color=_START["color"], linewidth=1.2)


def _write_names(axes: Axes, world: WorldModel) -> None:
    from matplotlib.patheffects import withStroke

    small: _Style = {"fontsize": 8, "color": "#444444", "ha": "center", "va": "center", "textcoords": "offset points"}
    small["path_effects"] = [withStroke(linewidth=2.5, foreground="white")]
    if len(world.obstacles) <= _MOST_NUMBERED:
        for number, obstacle in enumerate(world.solid_obstacles):
            axes.annotate(str(number), (obstacle.x_m, obstacle.y_m), xytext=(0, 0), **small)
    named: tuple[MovableBox | Beacon, ...] = (*world.boxes, *world.beacons)
    for name, thing in (*((thing.name, thing) for thing in named), *world.places.items()):
        axes.annotate(name, (thing.x_m, thing.y_m), xytext=(0, 13), **small)
    if len(world.start_poses) <= _MOST_NUMBERED:
        for number, pose in enumerate(world.start_poses):
            yaw_rad = math.radians(pose.yaw_deg)
            behind = (-9 * math.cos(yaw_rad), -9 * math.sin(yaw_rad))
            axes.annotate(str(number), (pose.x_m, pose.y_m), xytext=behind, **small)


def _legend(world: WorldModel) -> list[Artist]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    samples: tuple[tuple[object, Artist], ...] = (
        (world.obstacles, Patch(**_OBSTACLE, label="obstacle")),
        (world.boxes, Patch(**_BOX, label="movable box")),
        (world.drops, Patch(**_DROP, label="drop")),
        (world.keep_out, Patch(**_KEEP_OUT, label="keep-out zone")),
        (world.posters, Line2D([], [], **_POSTER, label="poster")),
        (world.beacons, Line2D([], [], **_BEACON, color="white", label="beacon")),
        (world.places, Line2D([], [], **_PLACE, label="place")),
        (world.lighting.lamps, Line2D([], [], **_LAMP, label="lamp")),
        (world.start_poses, Line2D([], [], **_START, label="start pose")),
    )
    return [sample for things, sample in samples if things]
