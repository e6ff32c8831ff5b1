"""Terminal output: the two consoles, tables, JSON, and short texts of values."""

from __future__ import annotations

import json
import math
import os
import reprlib
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any, Final, TextIO, cast

from rich import box
from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Table
from rich.text import Text
from typing_extensions import override

from eal_actors.device.data import DataType, EALData
from eal_actors.kernel.non_blocking_stream import NonBlockingStream
from eal_actors.kernel.printable import printable, printable_json

_PIPE_WIDTH: Final = 160  # columns of a table in a pipe or a file: wide, so that lines stay whole for grep
PAGE_WIDTH: Final = 80
"""Columns of a table in a pipe whose cells are texts for people."""
_MOST_ELEMENTS: Final = 32  # larger arrays are not printed in full


class _Console(Console):
    """A console for texts of robots and other programs, which must not control the terminal."""

    @override
    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        for segment in super().render(renderable, options):
            is_plain = segment.control is not None or segment.text.isprintable()
            yield segment if is_plain else segment._replace(text=printable(segment.text))


def stdout(pipe_width: int = _PIPE_WIDTH) -> Console:
    """Return a console on stdout, for results. Tables in a pipe or a file are `pipe_width` columns wide."""
    return _console(sys.stdout, pipe_width)


def service_output(file: TextIO | None = None) -> Console:
    """Return a console on a file, or stdout, for programs that run on: a paused terminal does not hold them up."""
    return _console(cast("TextIO", NonBlockingStream(file or sys.stdout)), _PIPE_WIDTH)


def stderr() -> Console:
    """Return a console on stderr, for everything that is not a result."""
    return _console(sys.stderr, _PIPE_WIDTH)


def _console(file: TextIO, pipe_width: int) -> Console:
    piped = not file.isatty() and "COLUMNS" not in os.environ
    return _Console(file=file, width=pipe_width if piped else None, highlight=False, markup=False, emoji=False)


def new_table(*columns: str, right: tuple[str, ...] = ()) -> Table:
    """Return an empty table; the columns named in `right` are right-aligned."""
    table = Table(*columns, box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, header_style="bold")
    for column in table.columns:
        column.overflow = "fold"
        column.justify = "right" if column.header in right else "left"
    return table


def print_line(console: Console, text: str | Text, style: str = "") -> None:
    """Print a line that the console does not wrap: terminals wrap it, and pipes and files keep it whole."""
    console.print(Text(text) if isinstance(text, str) else text, style=style, soft_wrap=True)


_json_stream: TextIO | None = None


@contextmanager
def json_alone() -> Iterator[None]:
    """Keep stdout for `json_output` during a `with` block: what plugins and their libraries print goes to stderr."""
    global _json_stream
    _json_stream = sys.stdout
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        _json_stream = None


def json_output() -> TextIO:
    """Return the stream for JSON: stdout, also where `json_alone` keeps it."""
    return _json_stream or sys.stdout


def write_json(value: Any) -> None:
    """Write a value to stdout as strict JSON; `as_json` replaces numbers that JSON cannot hold."""
    from eal_actors.scenario.report.records import as_json

    stream = json_output()
    is_unicode = (stream.encoding or "utf-8").lower().startswith("utf")
    stream.write(printable_json(as_json(value, indent=2, ensure_ascii=not is_unicode)) + "\n")


def counted(number: int, noun: str) -> str:
    """Return a number with its noun: `1 robot`, `3 robots`."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def format_answer(answer: EALData | int) -> str:
    """Return a value for people and shell scripts: bare numbers and text, a summary of large arrays."""
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
    if math.prod(shape) <= _MOST_ELEMENTS:
        return f"{json.dumps(to_json(answer))}{unit}"
    return f"{' x '.join(map(str, shape))} {answer.type.value}{unit}; --json prints every element"


def to_json(answer: EALData) -> Any:
    """Return an EALData's value for JSON: arrays as lists, bytes as a list of integers."""
    value = answer.value
    if answer.type is DataType.VOID:
        return None if value is None else list(value)
    return value.tolist() if hasattr(value, "tolist") else value
