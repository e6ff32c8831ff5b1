"""The processes of checkouts that a benchmark compares, and the command line of such a benchmark.

Each checkout has a process of its own. It runs the benchmark's file with the modules of that checkout, and makes the
calls that the benchmark asks for.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from tests.benchmarks.page import publish
from tests.benchmarks.peers.peer import ROOT


class Driver:
    """The process of a checkout.

    Args:
        checkout: its folder.
        program: file of this checkout that it runs.
    """

    def __init__(self, checkout: Path, program: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(Path(program).resolve()), "--drive"],
            cwd=checkout,
            env={**os.environ, "PYTHONPATH": str(checkout)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def ask(self, line: str) -> float:
        """Return the answer to a line."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()
        return float(self._process.stdout.readline())

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def compare(
    module: Any,
    table: Callable[[Sequence[Driver], int], str],
    *,
    rounds: int,
    one_core: bool,
) -> None:
    """Run a benchmark of two checkouts: measure, print the table, and write it into a page.

    Args:
        module: the benchmark's, with its documentation, its file and the mark BEGIN of its page. With `--drive` it
            answers the lines of a driver.
        table: returns the table in Markdown, given the drivers of the earlier checkout and of this one, and the rounds.
        rounds: the default.
        one_core: whether all processes share one core.
    """
    parser = argparse.ArgumentParser(description=module.__doc__)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--page", type=Path)
    parser.add_argument("--rounds", type=int, default=rounds)
    options = parser.parse_args()
    if options.before is None:
        parser.error("--before CHECKOUT is missing")
    if one_core:
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    drivers = [Driver(checkout, module.__file__) for checkout in (options.before, ROOT)]
    try:
        text = table(drivers, options.rounds)
    finally:
        for driver in drivers:
            driver.close()
    publish(text, options.page, module.BEGIN)
