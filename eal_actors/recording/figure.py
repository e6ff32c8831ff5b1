"""The paper that pictures are drawn on."""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING

from eal_actors.kernel.log import get_logger

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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
