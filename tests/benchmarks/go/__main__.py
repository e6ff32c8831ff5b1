"""Run the benchmarks of navigation and print their table: 20 seeds each, in lock step.

    python -m tests.benchmarks.go [PART]... [--page docs/navigation.md]

With a page, the table of each part is written into it, between the marks of that part.
"""

from __future__ import annotations

import argparse
import importlib
import pkgutil
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from rich.console import Console
from rich.table import Table

import tests.benchmarks.go
from tests.benchmarks.page import machine, write_between
from tests.benchmarks.result import Result, Skipped

HEADINGS = ("what", "ours", "reference", "figure", "limit", "")


def main(arguments: list[str]) -> int:
    """Return 1 if a figure missed its limit; all files of this folder are run if no names are given."""
    found = [info.name for info in pkgutil.iter_modules(tests.benchmarks.go.__path__) if info.name != "__main__"]
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.go", description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(found))
    parser.add_argument("--page", type=Path, help="the page to write the tables into")
    options = parser.parse_args(arguments)
    console, table, holds = Console(), Table(*HEADINGS), True
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as processes:
        for name in options.parts or found:
            module = importlib.import_module(f"tests.benchmarks.go.{name}")
            with console.status(f"measuring: {module.__doc__}"):
                results: list[Result | Skipped] = processes.submit(module.run).result()
            for result in results:
                table.add_row(*result.row(), style=None if result.holds else "bold red")
                holds &= result.holds
            if options.page is not None:
                write_between(options.page, f"<!-- bench-go {name} -->", _markdown(results))
    console.print(table)
    return 0 if holds else 1


def _markdown(results: list[Result | Skipped]) -> str:
    rows = [HEADINGS[:5], ("---",) * 5, *(result.row()[:5] for result in results)]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows) + f"\n\nMeasured on {machine()}."


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
