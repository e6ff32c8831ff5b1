"""A chart of the benchmark and the thesis's boards, as SVG or PNG."""

from __future__ import annotations

from pathlib import Path

from evbotos.bench import BOARDS, OPERATIONS, Benchmark
from evbotos.errors import MissingToolsError


def draw_chart(benchmark: Benchmark, path: Path) -> None:
    """Draw the seconds of each operation, on a logarithmic axis.

    Args:
        benchmark: the result.
        path: the output file; its suffix selects the format.

    Raises:
        MissingToolsError: matplotlib is not installed.
    """
    try:
        import matplotlib as mpl
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingToolsError("the chart needs matplotlib: pip install eal-actors[sim]") from None
    names = [*OPERATIONS.values(), "total"]
    series = {name: [*times, sum(times)] for name, times in BOARDS.items()}
    series[f"{benchmark.engine}, n = {benchmark.n}"] = [*benchmark.seconds.values(), benchmark.total_s]
    with mpl.rc_context({"svg.hashsalt": "evbotos", "font.size": 9}):
        figure = Figure(figsize=(8, 5.5), layout="constrained")
        axes = figure.subplots()
        height = 0.8 / len(series)
        for index, (name, seconds) in enumerate(series.items()):
            places = [row + (index - (len(series) - 1) / 2) * height for row in range(len(names))]
            axes.barh(places, [max(second, 1e-6) for second in seconds], height=height, label=name)
        axes.set_yticks(range(len(names)), names)
        axes.invert_yaxis()
        axes.set_xscale("log")
        axes.set_xlabel("seconds; boards at n = 1000")
        axes.set_title(f"Matrix benchmark on {benchmark.where}")
        figure.legend(loc="outside lower center", ncols=len(series))
        metadata = {"Date": None} if path.suffix == ".svg" else None
        figure.savefig(path, dpi=120, metadata=metadata)
