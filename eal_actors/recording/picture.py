"""Draw the robots' paths in their arena."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple, Self, TypeAlias

from eal_actors.device.world import WorldModel
from eal_actors.recording.arena import draw_arena
from eal_actors.recording.figure import draw_grid, new_figure
from eal_actors.recording.pose_sample import PoseSample, stretches

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_Dashes: TypeAlias = str | tuple[int, tuple[int, ...]]

# Okabe and Ito's palette: told apart with any colour vision. Each robot has a marker of its own as well.
_COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X")
_DASHES: Final[tuple[_Dashes, ...]] = ("-", (0, (6, 3)), (0, (1, 2)), (0, (7, 2, 1, 2)), (0, (3, 5)))
"""Styles of line with gaps that let those underneath show: headings often lie upon each other."""
_MOST_IN_LEGEND: Final = 14
_MOST_TICKS: Final = 8
_LOST: Final = ("dropped", "failed")
"""Outcomes that the picture tells of."""
_ARROW_M: Final = 0.28


class _Look(NamedTuple):
    """How a robot is drawn; `lost_as` is why it ends in a cross, or None."""

    colour: str
    marker: str
    dashes: _Dashes
    lost_as: str | None

    @classmethod
    def of(cls, number: int, lost_as: str | None) -> Self:
        """Return the look of the robot of a number."""
        return cls(
            _COLOURS[number % len(_COLOURS)],
            _MARKERS[number % len(_MARKERS)],
            _DASHES[number % len(_DASHES)],
            lost_as,
        )


def draw_trajectory(
    paths: Mapping[str, Sequence[PoseSample]],
    world: WorldModel | None,
    out: Path,
    title: str,
    outcomes: Mapping[str, str] | None = None,
    breaks_s: Sequence[float] = (),
) -> Path | None:
    """Draw each robot's path, from its start (hollow) to its end (filled, with its heading), and its heading over time.

    The second part shows what the first cannot: a robot that turns in place. A robot that failed or was dropped ends
    in a cross.

    Args:
        paths: samples by robot, as `PoseRecorder.paths_since` returns them.
        world: the arena, drawn as it was at first; None draws just the paths.
        out: the PNG file to write.
        title: the picture's title.
        outcomes: how robots fared, by name, see `RobotReport`; None says nothing of it.
        breaks_s: when the run, which was cut off, went on; the paths have gaps there.

    Returns:
        The file, or None when matplotlib is not installed, which is logged.
    """
    figure = _figure(paths, world, title, outcomes, breaks_s)
    if figure is None:
        return None
    figure.savefig(out)
    return out


def trajectory_svg(
    paths: Mapping[str, Sequence[PoseSample]],
    world: WorldModel | None,
    outcomes: Mapping[str, str] | None = None,
    breaks_s: Sequence[float] = (),
) -> str | None:
    """Return the same picture, without a title, as an SVG element for a page; None without matplotlib."""
    figure = _figure(paths, world, "", outcomes, breaks_s)
    if figure is None:
        return None
    out = io.StringIO()
    figure.savefig(out, format="svg")
    return out.getvalue()[out.getvalue().index("<svg") :]  # the XML head has no place inside a page


def _figure(
    paths: Mapping[str, Sequence[PoseSample]],
    world: WorldModel | None,
    title: str,
    outcomes: Mapping[str, str] | None,
    breaks_s: Sequence[float],
) -> Figure | None:
    figure = new_figure(9.0, 8.0)
    if figure is None:
        return None
    arena, headings = figure.subplots(2, 1, height_ratios=(3, 1))
    if world is not None:
        draw_arena(arena, world)
    for number, (name, path) in enumerate(paths.items()):
        if path:
            outcome = (outcomes or {}).get(name)
            look = _Look.of(number, outcome if outcome in _LOST else None)
            parts = stretches(path, breaks_s)
            _draw_path(arena, name, parts, look)
            _draw_heading(headings, parts, look)
    for break_s in breaks_s:
        headings.axvline(break_s, color="black", linewidth=0.8, linestyle=":")
    _label(arena, headings, title)
    if 0 < len(paths) <= _MOST_IN_LEGEND:
        arena.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, handlelength=3.5)
    return figure


def _label(arena: Axes, headings: Axes, title: str) -> None:
    tick_quarter_turns(headings)
    arena.set_title(title, loc="left", fontsize=12)
    arena.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    headings.set(xlabel="time [s]", ylabel="heading [°]")
    for axes in (arena, headings):
        draw_grid(axes)


def _draw_path(axes: Axes, name: str, parts: Sequence[Sequence[PoseSample]], look: _Look) -> None:
    for part in parts:
        xs, ys = [sample.x_m for sample in part], [sample.y_m for sample in part]
        axes.plot(xs, ys, color=look.colour, linestyle=look.dashes, linewidth=1.8)
        axes.plot(xs[:1], ys[:1], look.marker, color=look.colour, markerfacecolor="white", markersize=9)
    end = parts[-1][-1]
    label = f"{name} ({look.lost_as})" if look.lost_as else name
    axes.plot(
        [end.x_m], [end.y_m], marker=look.marker, color=look.colour, linestyle=look.dashes, markersize=9, label=label
    )
    if look.lost_as:
        _cross(axes, end.x_m, end.y_m)
    axes.annotate(
        "",
        xy=(end.x_m + _ARROW_M * math.cos(end.yaw_rad), end.y_m + _ARROW_M * math.sin(end.yaw_rad)),
        xytext=(end.x_m, end.y_m),
        arrowprops={"arrowstyle": "-|>", "color": look.colour, "linewidth": 1.8},
    )


def _draw_heading(axes: Axes, parts: Sequence[Sequence[PoseSample]], look: _Look) -> None:
    for part in parts:
        times_s = [sample.time_s for sample in part]
        headings_deg = [math.degrees(yaw_rad) for yaw_rad in _unwrapped(sample.yaw_rad for sample in part)]
        axes.plot(times_s, headings_deg, color=look.colour, linestyle=look.dashes, linewidth=1.8)
    axes.plot(times_s[-1:], headings_deg[-1:], look.marker, color=look.colour, markersize=6)
    if look.lost_as:
        _cross(axes, times_s[-1], headings_deg[-1])


def _cross(axes: Axes, x: float, y: float) -> None:
    axes.plot([x], [y], "x", color="black", markersize=13, markeredgewidth=2.2, zorder=5)


def tick_quarter_turns(axes: Axes) -> None:
    """Put the ticks of a heading a quarter turn apart, or two, four, eight, ... so that they stay few."""
    from matplotlib.ticker import MultipleLocator

    low_deg, high_deg = axes.get_ylim()
    step_deg = 90
    while high_deg - low_deg > step_deg * _MOST_TICKS:
        step_deg *= 2
    axes.yaxis.set_major_locator(MultipleLocator(step_deg))


def _unwrapped(angles_rad: Iterable[float]) -> Iterator[float]:
    """Yield the angles without the jumps between -π and π."""
    previous: float | None = None
    for angle_rad in angles_rad:
        if previous is None:
            previous = angle_rad
        else:
            previous += (angle_rad - previous + math.pi) % (2 * math.pi) - math.pi
        yield previous
