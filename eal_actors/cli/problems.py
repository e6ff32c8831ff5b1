"""Problems of files for people: the line of the file with a caret, and equal problems once."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.text import Text

from eal_actors.cli.output import print_line
from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.yaml_source import LARGE, read_file

_MOST_EQUAL: Final = 3
_MOST_LINES: Final = 8
_MOST_COLUMNS: Final = 76
_BEFORE: Final = 40  # columns of a long line that stay before the caret


def print_problems(console: Console, problems: Iterable[Problem]) -> None:
    """Print each problem as `file:line:column: path: message`, with its line; many equal ones in one line."""
    listed = list(problems)
    groups: dict[tuple[str, str], list[Problem]] = {}
    for problem in listed:
        groups.setdefault((problem.file, problem.message), []).append(problem)
    files: dict[str, list[str]] = {}
    for problem in listed:
        group = groups[problem.file, problem.message]
        if not any(problem is shown for shown in group[:_MOST_EQUAL]):
            continue
        print_line(console, str(problem))
        for line in _excerpt(problem, files):
            print_line(console, Text(line, style="dim"))
        if (further := group[_MOST_EQUAL:]) and problem is group[_MOST_EQUAL - 1]:
            what = "line" if len(further) == 1 else "lines"
            lines = ", ".join(str(one.line) for one in further[:_MOST_LINES])
            more = ", ..." if len(further) > _MOST_LINES else ""
            print_line(console, f"{problem.file}: {len(further)} more with this problem, in {what} {lines}{more}")


def _excerpt(problem: Problem, files: dict[str, list[str]]) -> tuple[str, ...]:
    """Return the line of a problem and a caret below it; nothing if the file cannot be read."""
    if not problem.line:
        return ()
    if problem.file not in files:
        try:
            files[problem.file] = read_file(Path(problem.file), LARGE).decode("utf-8", "replace").splitlines()
        except ConfigError:  # the content came from memory
            files[problem.file] = []
    lines = files[problem.file]
    if problem.line > len(lines):
        return ()
    first = max(0, problem.column - 1 - _BEFORE) if len(lines[problem.line - 1]) > _MOST_COLUMNS else 0
    line = lines[problem.line - 1][first : first + _MOST_COLUMNS].rstrip()
    blank = "".join(mark if mark == "\t" else " " for mark in line[: problem.column - 1 - first])
    return f"    {line}", f"    {blank.ljust(problem.column - 1 - first)}^"
