"""Picture of the robots' paths in their arena, and of their headings over time."""

from __future__ import annotations

import io
import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self, TypeAlias, TypeVar

from eal_actors.device.world import WorldModel
from eal_actors.recording.arena import draw_arena, draw_grid, new_figure
from eal_actors.recording.poses import PoseSample, index_at, split_at_breaks
from eal_actors.recording.run_folder import RunFolder, folder_errors
from eal_actors.scenario.report.summary import Report

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_Dashes: TypeAlias = str | tuple[int, tuple[int, ...]]

# Okabe and Ito's palette can be distinguished with any colour vision; wine replaces its yellow, which is pale on white.
COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#882255")
MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "*")
_DASHES: Final[tuple[_Dashes, ...]] = ("-", (0, (6, 3)), (0, (1, 2)), (0, (7, 2, 1, 2)), (0, (3, 5)))
"""Line styles with gaps: headings often cover each other."""
_MOST_IN_LEGEND: Final = 14
_MOST_TICKS: Final = 8
_LOST: Final = ("dropped", "failed")
"""Outcomes that are shown by a cross."""
_ARROW_M: Final = 0.28
_HEADINGS: Final = 8
"""Arrows along a path."""
_SMALL_ARROW: Final[dict[str, Any]] = {"scale": 34, "width": 0.0035, "alpha": 0.75, "zorder": 3}
_POINTS_PER_INCH: Final = 72
_MAP_IN: Final = 7.5
"""The width of the map of a page."""
_PICTURE: Final = "trajectory.png"


class _RobotStyle(NamedTuple):
    """The style of a robot's path; a cross shows the outcome `lost_as`, if it is not None, where it was at `lost_s`."""

    colour: str
    marker: str
    dashes: _Dashes
    lost_as: str | None
    lost_s: float

    @classmethod
    def of(cls, number: int, lost_as: str | None, lost_s: float) -> Self:
        """Return the style of the robot with a number: 64 robots differ in their colour or their marker."""
        marker = MARKERS[(number + number // len(COLOURS)) % len(MARKERS)]
        colour, dashes = COLOURS[number % len(COLOURS)], _DASHES[number % len(_DASHES)]
        return cls(colour, marker, dashes, lost_as, lost_s)


Out = TypeVar("Out", bound=Path | io.StringIO)


def draw_trajectory(
    paths: Mapping[str, Sequence[PoseSample]],
    world: WorldModel | None,
    out: Out,
    title: str = "",
    outcomes: Mapping[str, str] | None = None,
    breaks_s: Sequence[float] = (),
    lost_s: Mapping[str, float] | None = None,
) -> Out | None:
    """Draw each robot's path, from its start (hollow) to its end (filled, with its heading), and its heading over time.

    Small arrows along a path are its headings; over time they show a robot that turns in place, which its path cannot.
    A cross shows where a robot failed or was dropped.

    Args:
        paths: samples by robot, as `PoseRecorder.paths_since` returns them.
        world: the arena at its start; None draws the paths alone.
        out: the PNG file to write; or a text stream for an SVG document.
        title: the picture's title.
        outcomes: the outcomes of robots by name, see `RobotReport`; None shows none.
        breaks_s: the times at which the run was resumed; the paths have gaps there.
        lost_s: when robots failed or were dropped, by name; the end of the path by default. See `losses_of`.

    Returns:
        `out`, or None when matplotlib is not installed, which is logged.
    """
    figure = new_figure(9.0, 8.0)
    if figure is None:
        return None
    arena, headings = figure.subplots(2, 1, height_ratios=(3, 1))
    _draw_paths(arena, headings, paths, world, outcomes or {}, breaks_s, lost_s or {})
    for break_s in breaks_s:
        headings.axvline(break_s, color="black", linewidth=0.8, linestyle=":")
    _label(arena, title)
    tick_quarter_turns(headings)
    headings.set(xlabel="fleet time [s]", ylabel="heading [°]")
    draw_grid(headings)
    if 0 < len(paths) <= _MOST_IN_LEGEND:
        figure.legend(*arena.get_legend_handles_labels(), loc="outside right upper", frameon=False, handlelength=3.5)
    figure.savefig(out, format="svg" if isinstance(out, io.StringIO) else "png")
    return out


class MapPicture(NamedTuple):
    """The picture of the paths as SVG, and how its coordinates follow from those of the map.

    A place at x, y in metres is drawn at `zero_x + x * scale_x`, `zero_y - y * scale_y`.
    """

    svg: str
    zero_x: float
    zero_y: float
    scale_x: float
    scale_y: float


def draw_map(
    paths: Mapping[str, Sequence[PoseSample]],
    world: WorldModel | None,
    outcomes: Mapping[str, str] | None = None,
    breaks_s: Sequence[float] = (),
    lost_s: Mapping[str, float] | None = None,
) -> MapPicture | None:
    """Return the arena of `draw_trajectory`, for pages that draw on it; None when matplotlib is not installed."""
    figure = new_figure(_MAP_IN, _MAP_IN)
    if figure is None:
        return None
    axes = figure.subplots()
    _draw_paths(axes, None, paths, world, outcomes or {}, breaks_s, lost_s or {})
    _label(axes, "")
    (west, east), (south, north) = axes.get_xlim(), axes.get_ylim()
    figure.set_figheight(min(max(_MAP_IN * (north - south) / (east - west), _MAP_IN / 3), 1.5 * _MAP_IN))
    figure.set_dpi(_POINTS_PER_INCH)  # as the SVG is saved, so that the layout is the same
    out = io.StringIO()
    figure.savefig(out, format="svg")
    to_pixels = figure.axes[0].transData.transform
    (zero_x, zero_y), (one_x, one_y) = to_pixels((0.0, 0.0)), to_pixels((1.0, 1.0))
    top = figure.get_figheight() * _POINTS_PER_INCH
    svg = out.getvalue()
    scale = float(one_x - zero_x), float(one_y - zero_y)
    return MapPicture(svg[svg.index("<svg") :], float(zero_x), float(top - zero_y), *scale)  # without the XML head


def _draw_paths(
    arena: Axes,
    headings: Axes | None,
    paths: Mapping[str, Sequence[PoseSample]],
    world: WorldModel | None,
    outcomes: Mapping[str, str],
    breaks_s: Sequence[float],
    lost_s: Mapping[str, float],
) -> None:
    """Draw the robots' paths in their arena, and their headings over time if there are axes for them."""
    if world is not None:
        draw_arena(arena, world)
    for number, (name, path) in enumerate(paths.items()):
        if path:
            outcome = outcomes.get(name)
            style = _RobotStyle.of(number, outcome if outcome in _LOST else None, lost_s.get(name, path[-1].time_s))
            parts = split_at_breaks(path, breaks_s)
            _draw_path(arena, name, parts, style)
            if headings is not None:
                _draw_heading(headings, parts, style)


def losses_of(report: Report) -> dict[str, float]:
    """Return when robots failed or were dropped, in seconds since the run's start: at the end of their failed step."""
    lost = {name for name, robot in report.robots.items() if robot.outcome in _LOST}
    return {step.robot: step.end_s for step in report.steps if step.robot in lost and step.error is not None}


def draw_run(run: RunFolder, report: Report, world: WorldModel | None) -> Path | None:
    """Draw the robots' paths into the run's folder; raise ScenarioError if the picture cannot be written.

    Return the picture; None if no robot has a Pose, or matplotlib is missing, which is logged.
    """
    if not run.paths:
        return None
    title = f"{report.scenario} on {report.fleet}: {report.outcome}"
    outcomes = {name: robot.outcome for name, robot in report.robots.items()}
    with folder_errors(run.path):
        return draw_trajectory(run.paths, world, run.path / _PICTURE, title, outcomes, run.breaks_s, losses_of(report))


def _label(arena: Axes, title: str) -> None:
    arena.set_title(title, loc="left", fontsize=12)
    arena.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    draw_grid(arena)


def _draw_path(axes: Axes, name: str, parts: Sequence[Sequence[PoseSample]], style: _RobotStyle) -> None:
    for part in parts:
        xs, ys = [sample.x_m for sample in part], [sample.y_m for sample in part]
        axes.plot(xs, ys, color=style.colour, linestyle=style.dashes, linewidth=1.8)
        axes.plot(xs[:1], ys[:1], style.marker, color=style.colour, markerfacecolor="white", markersize=9)
        _draw_arrows(axes, part, style.colour)
    end = parts[-1][-1]
    label = f"{name} ({style.lost_as})" if style.lost_as else name
    axes.plot(
        [end.x_m], [end.y_m], marker=style.marker, color=style.colour, linestyle=style.dashes, markersize=9, label=label
    )
    if style.lost_as:
        path = [sample for part in parts for sample in part]
        there = path[index_at(path, style.lost_s)]
        _cross(axes, there.x_m, there.y_m)
    axes.annotate(
        "",
        xy=(end.x_m + _ARROW_M * math.cos(end.yaw_rad), end.y_m + _ARROW_M * math.sin(end.yaw_rad)),
        xytext=(end.x_m, end.y_m),
        arrowprops={"arrowstyle": "-|>", "color": style.colour, "linewidth": 1.8},
    )


def _draw_arrows(axes: Axes, path: Sequence[PoseSample], colour: str) -> None:
    """Draw the headings at a few times of a path."""
    chosen = path[:: max(1, len(path) // _HEADINGS)]
    xs, ys = [sample.x_m for sample in chosen], [sample.y_m for sample in chosen]
    ahead = [math.cos(sample.yaw_rad) for sample in chosen], [math.sin(sample.yaw_rad) for sample in chosen]
    angles = [math.degrees(sample.yaw_rad) for sample in chosen]  # `xy` divides by zero if all robots stay at 0, 0
    axes.quiver(xs, ys, *ahead, angles=angles, color=colour, **_SMALL_ARROW)


def _draw_heading(axes: Axes, parts: Sequence[Sequence[PoseSample]], style: _RobotStyle) -> None:
    import numpy as np

    drawn: list[tuple[float, float]] = []
    for part in parts:
        times_s = [sample.time_s for sample in part]
        headings_deg = np.degrees(np.unwrap([sample.yaw_rad for sample in part]))
        axes.plot(times_s, headings_deg, color=style.colour, linestyle=style.dashes, linewidth=1.8)
        drawn += zip(times_s, headings_deg, strict=True)
    axes.plot(*drawn[-1], style.marker, color=style.colour, markersize=6)
    if style.lost_as:
        _cross(axes, *drawn[max(0, bisect_right(drawn, (style.lost_s, math.inf)) - 1)])


def _cross(axes: Axes, x: float, y: float) -> None:
    axes.plot([x], [y], "x", color="black", markersize=13, markeredgewidth=2.2, zorder=5)


def tick_quarter_turns(axes: Axes) -> None:
    """Set the ticks of a heading 1, 2, 4, 8, ... quarter turns apart, so that there are few."""
    from matplotlib.ticker import MultipleLocator

    low_deg, high_deg = axes.get_ylim()
    step_deg = 90
    while high_deg - low_deg > step_deg * _MOST_TICKS:
        step_deg *= 2
    axes.yaxis.set_major_locator(MultipleLocator(step_deg))
