"""Writing to the terminal: the two consoles, tables, JSON, and values in few words."""

from __future__ import annotations

import json
import os
import reprlib
import sys
from pathlib import Path
from typing import Any, Final, TextIO

from rich import box
from rich.console import Console
from rich.table import Table

from eal_actors.device.data import DataType, EALData
from eal_actors.scenario.report.records import as_json

_PIPE_WIDTH: Final = 160
"""Columns where nobody looks at them: wide, so that lines stay whole for grep."""
_WHOLE_ARRAY: Final = 32
"""Arrays of up to so many elements are printed whole."""


def stdout() -> Console:
    """Return a console on stdout: the results."""
    return _console(sys.stdout)


def stderr() -> Console:
    """Return a console on stderr: everything that is not a result."""
    return _console(sys.stderr)


def _console(file: TextIO) -> Console:
    piped = not file.isatty() and "COLUMNS" not in os.environ
    return Console(file=file, width=_PIPE_WIDTH if piped else None, highlight=False, markup=False, emoji=False)


def new_table(*columns: str) -> Table:
    """Return an empty table in the house's style."""
    table = Table(*columns, box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, header_style="bold")
    for column in table.columns:
        column.overflow = "fold"
    return table


def write_json(value: Any) -> None:
    """Write a value to stdout as strict JSON, and nothing else: see `as_json` for numbers that are none."""
    sys.stdout.write(as_json(value, indent=2, ensure_ascii=False) + "\n")


def counted(number: int, what: str) -> str:
    """Return `1 robot`, `3 robots`."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def short_path(path: Path) -> Path:
    """Return a path as it is from here, where it lies below."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path


def shown_value(answer: EALData | int) -> str:
    """Return a value as people and shell scripts want it: numbers and text bare, large arrays in few words."""
    if not isinstance(answer, EALData):
        return str(answer)
    value, unit = answer.value, f" {answer.unit}" if answer.unit else ""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return value
    if isinstance(value, bytes):
        return f"{len(value)} bytes: {reprlib.repr(value)}"
    if not answer.is_ptr:
        return f"{value}{unit}"
    shape = answer.shape or (len(value),)
    count = 1
    for size in shape:
        count *= size
    if count <= _WHOLE_ARRAY:
        numbers = plain(answer)
        return f"{json.dumps(numbers)}{unit}"
    sizes = " x ".join(map(str, shape))
    return f"{sizes} {answer.type.value}{unit}; --json prints every element"


def plain(answer: EALData) -> Any:
    """Return an EALData's value as JSON can hold it: arrays as lists, bytes as a list of ints."""
    value = answer.value
    if answer.type is DataType.VOID:
        return None if value is None else list(value)
    return value.tolist() if hasattr(value, "tolist") else value
