"""Terminal output, and the table of errors and exit codes."""

from __future__ import annotations

import enum
import json
import sys
from typing import Any, Final

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from eal_actors.kernel.errors import ConfigError, EALError
from evbotos.errors import BuildError, FlashError, MissingToolsError, UpdateError


class ExitCode(enum.IntEnum):
    """The exit codes of `evbotos`."""

    DONE = 0
    FAILED = 1
    BAD_INPUT = 2
    TOOLS_MISSING = 3
    INTERRUPTED = 130


EPILOG: Final = (
    "Exit codes: 0 done; 1 a build, flash or update failed; 2 wrong input: a file, a name, an argument; "
    "3 programs are not installed; 130 interrupted."
)
_CODES: Final[tuple[tuple[type[EALError], ExitCode], ...]] = (
    (ConfigError, ExitCode.BAD_INPUT),
    (MissingToolsError, ExitCode.TOOLS_MISSING),
    (BuildError, ExitCode.FAILED),
    (FlashError, ExitCode.FAILED),
    (UpdateError, ExitCode.FAILED),
    (EALError, ExitCode.FAILED),
)


def console(*, error: bool = False) -> Console:
    """Return the console of stdout for results, or of stderr for everything else."""
    file = sys.stderr if error else sys.stdout
    return Console(file=file, width=None if file.isatty() else 160, highlight=False, markup=False, emoji=False)


def new_table(*columns: str) -> Table:
    """Return an empty table in the common style."""
    table = Table(*columns, box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, header_style="bold")
    for column in table.columns:
        column.overflow = "fold"
    return table


def write_json(value: Any) -> None:
    """Write a value to stdout as JSON."""
    sys.stdout.write(json.dumps(value, indent=2, ensure_ascii=False) + "\n")


def report(error: EALError) -> ExitCode:
    """Print an error to stderr and return its exit code."""
    out = console(error=True)
    if isinstance(error, ConfigError):
        for problem in error.problems:
            out.print(str(problem), soft_wrap=True)
        count = len(error.problems)
        out.print(f"{count} problem{'s' * (count != 1)}; nothing was changed.", style="dim")
    else:
        out.print(Text.assemble(("Error: ", "bold red"), str(error)), soft_wrap=True)
    return next(code for kind, code in _CODES if isinstance(error, kind))
