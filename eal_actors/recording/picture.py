"""Draw the robots' paths in their arena."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from eal_actors.log import get_logger
from eal_actors.recording.poses import PoseSample
from eal_actors.world import BoxObstacle, WorldModel

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Okabe and Ito's palette: told apart with any colour vision. Each robot has a marker of its own as well.
_COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X")
_MOST_IN_LEGEND: Final = 14
_ARROW_M: Final = 0.28


def draw_trajectory(
    paths: Mapping[str, Sequence[PoseSample]], world: WorldModel | None, out: Path, title: str
) -> Path | None:
    """Draw each robot's path, from its start (hollow) to its end (filled, with its heading), and its heading over time.

    The second part shows what the first cannot: a robot that turns in place.

    Args:
        paths: samples by robot.
        world: the arena's walls and obstacles; None draws just the paths.
        out: the PNG file to write.
        title: the picture's title.

    Returns:
        The file, or None when matplotlib is not installed, which is logged.
    """
    if importlib.util.find_spec("matplotlib") is None:
        get_logger().warning("no picture: matplotlib is missing", remedy="pip install 'eal-actors[sim]'")
        return None
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 8), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    arena, headings = figure.subplots(2, 1, height_ratios=(3, 1))
    if world is not None:
        _draw_world(arena, world)
    start_s = min((path[0].time_s for path in paths.values() if path), default=0.0)
    for number, (name, path) in enumerate(paths.items()):
        if path:
            colour, marker = _COLOURS[number % len(_COLOURS)], _MARKERS[number % len(_MARKERS)]
            _draw_path(arena, name, path, colour, marker)
            _draw_heading(headings, path, start_s, colour, marker)
    arena.set_title(title, loc="left", fontsize=12)
    arena.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    headings.set(xlabel="time [s]", ylabel="heading [°]")
    for axes in (arena, headings):
        axes.grid(visible=True, color="#dddddd", linewidth=0.6)
        axes.set_axisbelow(True)
    if 0 < len(paths) <= _MOST_IN_LEGEND:
        arena.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)
    figure.savefig(out)
    return out


def _draw_world(axes: Axes, world: WorldModel) -> None:
    from matplotlib.patches import Circle, Rectangle

    width_m, height_m = world.size_m
    axes.add_patch(Rectangle((-width_m / 2, -height_m / 2), width_m, height_m, fill=False, linewidth=2.5))
    for obstacle in world.obstacles:
        style: dict[str, Any] = {"facecolor": "#d9d9d9", "edgecolor": "#7f7f7f"}
        if isinstance(obstacle, BoxObstacle):
            corner = (obstacle.x_m - obstacle.width_m / 2, obstacle.y_m - obstacle.height_m / 2)
            axes.add_patch(
                Rectangle(
                    corner,
                    obstacle.width_m,
                    obstacle.height_m,
                    angle=obstacle.yaw_deg,
                    rotation_point="center",
                    **style,
                )
            )
        else:
            axes.add_patch(Circle((obstacle.x_m, obstacle.y_m), obstacle.radius_m, **style))
    margin_m = 0.05 * max(width_m, height_m)
    axes.set_xlim(-width_m / 2 - margin_m, width_m / 2 + margin_m)
    axes.set_ylim(-height_m / 2 - margin_m, height_m / 2 + margin_m)


def _draw_path(axes: Axes, name: str, path: Sequence[PoseSample], colour: str, marker: str) -> None:
    xs, ys = [sample.x_m for sample in path], [sample.y_m for sample in path]
    axes.plot(xs, ys, color=colour, linewidth=1.8)
    axes.plot(xs[:1], ys[:1], marker, color=colour, markerfacecolor="white", markersize=9)
    axes.plot(xs[-1:], ys[-1:], marker, color=colour, markersize=9, label=name)
    end = path[-1]
    axes.annotate(
        "",
        xy=(end.x_m + _ARROW_M * math.cos(end.yaw_rad), end.y_m + _ARROW_M * math.sin(end.yaw_rad)),
        xytext=(end.x_m, end.y_m),
        arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 1.8},
    )


def _draw_heading(axes: Axes, path: Sequence[PoseSample], start_s: float, colour: str, marker: str) -> None:
    times_s = [sample.time_s - start_s for sample in path]
    headings_deg = [math.degrees(yaw_rad) for yaw_rad in _unwrapped(sample.yaw_rad for sample in path)]
    axes.plot(times_s, headings_deg, color=colour, linewidth=1.5)
    axes.plot(times_s[-1:], headings_deg[-1:], marker, color=colour, markersize=6)


def _unwrapped(angles_rad: Iterable[float]) -> Iterator[float]:
    """Yield the angles without the jumps between -π and π."""
    previous: float | None = None
    for angle_rad in angles_rad:
        if previous is None:
            previous = angle_rad
        else:
            previous += (angle_rad - previous + math.pi) % (2 * math.pi) - math.pi
        yield previous
