"""Picture of an occupancy grid, with a path and places."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from eal_actors.device.navigation.grid import INFLATED, OCCUPIED_FROM, OccupancyGrid
from eal_actors.device.world import WorldModel
from eal_actors.recording.arena import draw_arena, draw_grid, new_figure

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

_FREE_RGB: Final = (255, 255, 255)
_UNKNOWN_RGB: Final = (190, 200, 210)
_INFLATED_RGB: Final = (247, 226, 200)
_OCCUPIED_RGB: Final = (60, 60, 66)
_PATH: Final[dict[str, Any]] = {"color": "#0072b2", "linewidth": 2.2, "solid_joinstyle": "round", "zorder": 4}
_PLACE: Final[dict[str, Any]] = {"linestyle": "", "marker": "P", "markersize": 8, "color": "#0072b2", "zorder": 5}


def draw_map(
    grid: OccupancyGrid,
    out: Path,
    *,
    title: str,
    path: Sequence[tuple[float, float]] = (),
    places: Mapping[str, tuple[float, float]] | None = None,
    world: WorldModel | None = None,
) -> Path | None:
    """Draw a map: occupied cells dark, cells too near to them orange, unknown ones grey; and a path on it.

    Args:
        grid: the map; inflated ones show where the centre of a robot may be.
        out: the file to write; its suffix selects the format, such as `.png` or `.svg`.
        title: the picture's title.
        path: x and y of a path's corners in the map frame.
        places: x and y of places by name.
        world: the world of the map, whose things are drawn over it.

    Returns:
        The file, or None when matplotlib is not installed, which is logged.

    Raises:
        OSError: it cannot be written.
    """
    known = np.argwhere(grid.cells >= 0)
    around = grid.centres(known) if len(known) else grid.corners
    (west, south), (east, north) = around.min(axis=0), around.max(axis=0)
    figure = new_figure(9.0, float(np.clip(8.0 * (north - south) / max(east - west, grid.resolution_m), 3.0, 16.0)))
    if figure is None:
        return None
    from matplotlib.transforms import Affine2D

    axes = figure.subplots()
    draw_grid(axes)
    rows, columns = grid.cells.shape
    turn = Affine2D().scale(grid.resolution_m).rotate(grid.origin.yaw_rad).translate(*grid.origin[:2])
    extent = (0, columns, 0, rows)
    axes.imshow(_colours(grid), origin="lower", extent=extent, interpolation="none", transform=turn + axes.transData)
    if world is not None:
        draw_arena(axes, world)
    if path:
        xs, ys = zip(*path, strict=True)
        axes.plot(xs, ys, **_PATH)
        axes.plot(xs[:1], ys[:1], "o", color=_PATH["color"], markerfacecolor="white", markersize=9, zorder=5)
        axes.plot(xs[-1:], ys[-1:], "o", color=_PATH["color"], markersize=9, zorder=5)
    _draw_places(axes, places or {})
    margin_m = 0.05 * max(east - west, north - south) + grid.resolution_m
    axes.set(xlim=(west - margin_m, east + margin_m), ylim=(south - margin_m, north + margin_m))
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.set_title(title, loc="left", fontsize=12)
    axes.legend(handles=_legend(has_path=bool(path)), loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)
    figure.savefig(out, bbox_inches="tight")
    return out


def _draw_places(axes: Axes, places: Mapping[str, tuple[float, float]]) -> None:
    from matplotlib.patheffects import withStroke

    for name, (x_m, y_m) in places.items():
        axes.plot([x_m], [y_m], markeredgecolor="white", **_PLACE)
        label: dict[str, Any] = {"textcoords": "offset points", "ha": "center", "fontsize": 9}
        axes.annotate(name, (x_m, y_m), (0, 11), path_effects=[withStroke(linewidth=2.5, foreground="white")], **label)


def _legend(*, has_path: bool) -> list[Artist]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    entries: list[Artist] = [
        Patch(facecolor=(colour[0] / 255, colour[1] / 255, colour[2] / 255), edgecolor="#7f7f7f", label=label)
        for colour, label in ((_OCCUPIED_RGB, "occupied"), (_INFLATED_RGB, "too near"), (_UNKNOWN_RGB, "unknown"))
    ]
    return [*entries, Line2D([], [], label="path", **_PATH)] if has_path else entries


def _colours(grid: OccupancyGrid) -> np.ndarray:
    """Return the colours of the cells, shape (rows, columns, 3)."""
    colours = np.full((*grid.cells.shape, 3), _FREE_RGB, np.uint8)
    colours[grid.cells >= OCCUPIED_FROM] = _OCCUPIED_RGB
    colours[grid.cells == INFLATED] = _INFLATED_RGB
    colours[grid.cells < 0] = _UNKNOWN_RGB
    return colours
