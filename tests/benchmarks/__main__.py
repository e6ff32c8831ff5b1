"""Run the benchmarks, print their table, and write it into the documentation."""

from __future__ import annotations

import platform
import sys
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path

from rich.console import Console
from rich.table import Table

from tests.benchmarks import camera, crowd, dashboard, engine, hop, network, simulation
from tests.benchmarks.result import Result, Skipped

HEADINGS = ("what", "ours", "reference, same run", "figure", "limit", "")
PAGE = Path(__file__).parents[2] / "docs" / "benchmarks.md"


def main() -> int:
    """Return 1 if a figure missed its limit."""
    console = Console()
    results: list[Result | Skipped] = []
    # A process for each: what one leaves in memory must not slow down the next.
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as processes:
        for benchmark in (hop, crowd, engine, simulation, camera, dashboard, network):
            with console.status(f"measuring: {benchmark.__doc__}"):
                results += processes.submit(benchmark.run).result()
    table = Table(*HEADINGS)
    for result in results:
        table.add_row(*result.row(), style=None if result.holds else "bold red")
    console.print(table)
    machine = f"{platform.machine()}, Python {platform.python_version()}, Pykka {version('pykka')}"
    rows = [HEADINGS, ("---",) * len(HEADINGS), *(result.row() for result in results)]
    PAGE.parent.mkdir(exist_ok=True)
    PAGE.write_text(
        "# Benchmarks\n\n`make bench` writes this page. Each ratio compares with a reference in the same run.\n\n"
        + "\n".join("| " + " | ".join(row) + " |" for row in rows)
        + f"\n\n{datetime.now(UTC):%Y-%m-%d}, {machine}.\n"
    )
    return 0 if all(result.holds for result in results) else 1


if __name__ == "__main__":
    sys.exit(main())
