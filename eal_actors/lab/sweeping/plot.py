"""Plot of a sweep: the median and the spread over the seeds, against the first parameter."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from eal_actors.lab.sweeping.results import SweepResult
from eal_actors.lab.sweeping.sweep import format_value
from eal_actors.recording.arena import draw_grid, new_figure
from eal_actors.recording.picture import COLOURS, MARKERS
from eal_actors.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_PANELS: Final = 6
_MOST_LINES: Final = 10
_COLUMNS: Final = 3
_DURATION: Final = "duration_s"
_UNITS: Final = {
    "m_s": "m/s",
    "rad_s": "rad/s",
    "deg_s": "°/s",
    "mm": "mm",
    "m": "m",
    "rad": "rad",
    "deg": "°",
    "s": "s",
}
"""Units by the ends of names."""


def draw_sweep(results: Sequence[SweepResult], scenario: Scenario, file: Path) -> Path | None:
    """Draw a panel for the duration and for each numeric variable, with a line for each choice of the other parameters.

    With several seeds, the line is their median, and the band spans minimum to maximum. Runs that are not done are left
    out of both; a cross on the axis shows where there are any. Return the file; None if there is nothing to draw, or if
    matplotlib is not installed, which is logged.
    """
    done = [result for result in results if result.outcome == "done"]
    measures = _measures(done)
    if not done or not done[0].job.varied:
        return None
    columns, rows = min(_COLUMNS, len(measures)), -(-len(measures) // min(_COLUMNS, len(measures)))
    figure = new_figure(4.6 * columns, 3.4 * rows + 0.4)
    if figure is None:
        return None
    first = next(iter(done[0].job.varied))
    unit = scenario.file.parameters[first].unit
    panels = figure.subplots(rows, columns, squeeze=False).flat
    for axes, (name, values) in zip(panels, measures.items(), strict=False):
        _draw_panel(axes, results, first, values)
        robot, _, quantity = name.rpartition(".")
        axes.set_title(f"{_words(quantity)} of {robot}" if robot else _words(quantity))
        axes.set(xlabel=_axis_label(first, unit), ylabel=_axis_label(quantity))
        draw_grid(axes)
    for axes in list(panels)[len(measures) :]:
        axes.set_visible(False)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    if any(labels):
        figure.legend(handles, labels, loc="outside lower center", ncols=min(4, len(labels)), frameon=False)
    seeds = len({result.job.seed for result in done})
    spread = f": median of {seeds} seeds, minimum to maximum" if seeds > 1 else ""
    figure.suptitle(f"{scenario.name}{spread}")
    figure.savefig(file, metadata={"Software": None})
    return file


def _words(name: str) -> str:
    """Return a variable's name for people, without its unit: `distance` for `distance_m`."""
    unit = _ending(name)
    return (name.removesuffix(f"_{unit}") if unit else name).replace("_", " ")


def _ending(name: str) -> str | None:
    return next((unit for unit in _UNITS if name.endswith(f"_{unit}")), None)


def _unit(name: str) -> str | None:
    unit = _ending(name)
    return _UNITS[unit] if unit else None


def _axis_label(name: str, unit: str | None = None) -> str:
    """Return name and unit, the declared one or that of the name: `distance [m]`."""
    symbol = unit or _unit(name)
    return f"{_words(name)} [{symbol}]" if symbol else _words(name)


def _measures(done: Sequence[SweepResult]) -> dict[str, dict[str, float]]:
    """Return the measured quantities: for each, its value by the name of the run."""
    found: dict[str, dict[str, float]] = {_DURATION: {}}
    for result in done:
        if result.duration_s is not None:
            found[_DURATION][result.job.name] = result.duration_s
        for name, value in result.variables.items():
            if isinstance(value, int | float) and not isinstance(value, bool):
                found.setdefault(name, {})[result.job.name] = float(value)
    return dict(list(found.items())[:_MOST_PANELS])


def _draw_panel(axes: Axes, results: Sequence[SweepResult], first: str, values: Mapping[str, float]) -> None:
    each = dict.fromkeys(result.job.varied[first] for result in results)
    has_numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in each)
    positions = {value: float(value if has_numbers else index) for index, value in enumerate(each)}
    lines = list(_group_by_line(results, first, values).items())[:_MOST_LINES]
    for number, (label, points) in enumerate(lines):
        ordered = sorted((positions[value], group) for value, group in points.items())
        x, groups = [position for position, _ in ordered], [group for _, group in ordered]
        colour, marker = COLOURS[number % len(COLOURS)], MARKERS[number % len(MARKERS)]
        axes.plot(x, list(map(statistics.median, groups)), color=colour, marker=marker, ms=5, label=label)
        if any(len(group) > 1 for group in groups):
            low, high = list(map(min, groups)), list(map(max, groups))
            axes.fill_between(x, low, high, color=colour, alpha=0.2, linewidth=0)
    _mark_not_done(axes, results, first, positions)
    if not has_numbers:
        axes.set_xticks(list(positions.values()), [format_value(value) for value in positions])


def _mark_not_done(axes: Axes, results: Sequence[SweepResult], first: str, positions: Mapping[Any, float]) -> None:
    """Draw a cross on the axis at each value with a run that is not done."""
    x = sorted({positions[result.job.varied[first]] for result in results if result.outcome != "done"})
    if x:
        label, at_axis = "a run is not done", axes.get_xaxis_transform()
        axes.plot(x, [0.0] * len(x), "x", c="#cc0000", mew=2, clip_on=False, transform=at_axis, label=label)


def _group_by_line(
    results: Sequence[SweepResult], first: str, values: Mapping[str, float]
) -> dict[str, dict[Any, list[float]]]:
    """Return the values of each line, by the values of the first parameter; the other parameters label the line."""
    lines: dict[str, dict[Any, list[float]]] = {}
    for result in results:
        if result.job.name in values:
            others = ((name, value) for name, value in result.job.varied.items() if name != first)
            label = ", ".join(
                f"{_words(name)} {format_value(value)} {_unit(name) or ''}".rstrip() for name, value in others
            )
            lines.setdefault(label, {}).setdefault(result.job.varied[first], []).append(values[result.job.name])
    return lines
