"""Draws what came of a sweep: the median over the seeds, and their spread, against the first parameter."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from eal_actors.lab.sweeping.results import Result
from eal_actors.lab.sweeping.sweep import Job
from eal_actors.recording.arena import draw_grid, new_figure
from eal_actors.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_PANELS: Final = 6
_MOST_LINES: Final = 10
_COLUMNS: Final = 3
_DURATION: Final = "duration_s"


def draw_sweep(results: Sequence[Result], scenario: Scenario, file: Path) -> Path | None:
    """Draw a panel for the duration and for each variable that is a number, a line for each choice of the others.

    Where several seeds were run, the line is their median, and the band goes from the least to the greatest. Runs that
    are not done are left out.

    Args:
        results: the runs, which vary something.
        scenario: what was run.
        file: where to.

    Returns:
        The file; None where there is nothing to draw, or matplotlib is not installed, which is logged.
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
    axis = _axis(first, scenario)
    panels = figure.subplots(rows, columns, squeeze=False).flat
    for axes, (name, values) in zip(panels, measures.items(), strict=False):
        _draw(axes, done, first, values)
        axes.set_title(name)
        axes.set_xlabel(axis)
        draw_grid(axes)
    for axes in list(panels)[len(measures) :]:
        axes.set_visible(False)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    if any(labels):
        figure.legend(handles, labels, loc="outside lower center", ncols=min(4, len(labels)), frameon=False)
    seeds = len({result.job.seed for result in done})
    spread = f": median of {seeds} seeds, and from the least to the greatest" if seeds > 1 else ""
    figure.suptitle(f"{scenario.name}{spread}")
    figure.savefig(file, metadata={"Software": None})
    return file


def _axis(name: str, scenario: Scenario) -> str:
    unit = scenario.file.parameters[name].unit
    return f"{name} [{unit}]" if unit and not name.endswith(f"_{unit}") else name


def _measures(done: Sequence[Result]) -> dict[str, dict[str, float]]:
    """Return, by what is measured, the number of each run that has one, by the name of the run."""
    found: dict[str, dict[str, float]] = {_DURATION: {}}
    for result in done:
        if result.duration_s is not None:
            found[_DURATION][result.job.name] = result.duration_s
        for name, value in result.variables.items():
            if isinstance(value, int | float) and not isinstance(value, bool):
                found.setdefault(name, {})[result.job.name] = float(value)
    return dict(list(found.items())[:_MOST_PANELS])


def _draw(axes: Axes, done: Sequence[Result], first: str, values: Mapping[str, float]) -> None:
    lines: dict[str, dict[Any, list[float]]] = {}
    for result in done:
        if result.job.name in values:
            line = lines.setdefault(_others(result.job, first), {})
            line.setdefault(result.job.varied[first], []).append(values[result.job.name])
    places = _places([result.job.varied[first] for result in done])
    for label, points in list(lines.items())[:_MOST_LINES]:
        ordered = sorted((places[value], group) for value, group in points.items())
        x, groups = [place for place, _ in ordered], [group for _, group in ordered]
        (line_drawn,) = axes.plot(x, [statistics.median(group) for group in groups], "o-", ms=4, label=label)
        if any(len(group) > 1 for group in groups):
            low, high = [min(group) for group in groups], [max(group) for group in groups]
            axes.fill_between(x, low, high, color=line_drawn.get_color(), alpha=0.2, linewidth=0)
    if not _are_numbers(places):
        axes.set_xticks(list(places.values()), [str(value) for value in places])


def _others(job: Job, first: str) -> str:
    return ", ".join(f"{name}={value}" for name, value in job.varied.items() if name != first)


def _places(values: Sequence[Any]) -> dict[Any, float]:
    """Return where on the axis a value stands: numbers where they are, all else side by side."""
    each = dict.fromkeys(values)
    return {value: float(value) if _are_numbers(each) else float(index) for index, value in enumerate(each)}


def _are_numbers(values: Mapping[Any, object]) -> bool:
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
