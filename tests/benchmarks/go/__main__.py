"""Run the benchmarks of navigation and print their table: 20 seeds each, in lock step."""

from __future__ import annotations

import importlib
import pkgutil
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from rich.console import Console
from rich.table import Table

import tests.benchmarks.go
from tests.benchmarks.result import Result, Skipped

HEADINGS = ("what", "ours", "reference", "figure", "limit", "")


def main(names: list[str]) -> int:
    """Return 1 if a figure missed its limit; all files of this folder are run if no names are given."""
    console = Console()
    found = [info.name for info in pkgutil.iter_modules(tests.benchmarks.go.__path__) if info.name != "__main__"]
    results: list[Result | Skipped] = []
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as processes:
        for name in names or found:
            module = importlib.import_module(f"tests.benchmarks.go.{name}")
            with console.status(f"measuring: {module.__doc__}"):
                results += processes.submit(module.run).result()
    table = Table(*HEADINGS)
    for result in results:
        table.add_row(*result.row(), style=None if result.holds else "bold red")
    console.print(table)
    return 0 if all(result.holds for result in results) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
