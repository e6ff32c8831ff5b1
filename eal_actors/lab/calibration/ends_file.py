"""Where squares ended, as a table in a file: what a person measured, or a scenario recorded."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from eal_actors.kernel.errors import ArgumentError, ConfigError, Problem
from eal_actors.lab.calibration.square import WAYS
from eal_actors.lab.calibration.umbmark import Point, SquareEnds

_COLUMNS: Final = ("way", "x_m", "y_m")


def read_ends(file: Path) -> SquareEnds:
    """Read a CSV file with the columns way (cw or ccw), x_m and y_m, in any order; others are passed over.

    Raises:
        ConfigError: everything that is wrong with the file.
    """
    problems: list[Problem] = []
    ends = {way: list[Point]() for way in WAYS}
    for line, row in _rows(file):
        way, texts = row["way"], (row["x_m"], row["y_m"])
        if way not in ends:
            problems.append(Problem(str(file), line, 1, "way", f"must be cw or ccw, not {way!r}"))
            continue
        try:
            x_m, y_m = map(float, texts)
            ends[way].append((x_m, y_m))
        except ValueError:
            problems.append(Problem(str(file), line, 1, "x_m, y_m", f"must be numbers, not {', '.join(texts)}"))
    if problems:
        raise ConfigError(problems)
    try:
        return SquareEnds(ends["cw"], ends["ccw"])
    except ArgumentError as error:
        raise ConfigError([Problem(str(file), 0, 0, "", error.message)]) from None


def _rows(file: Path) -> Iterable[tuple[int, dict[str, str]]]:
    """Return each row with its line; all have what is needed."""
    try:
        with file.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.DictReader(stream, restval="", skipinitialspace=True)
            lacking = [name for name in _COLUMNS if name not in (reader.fieldnames or ())]
            if lacking:
                message = f"its first line must name the columns {', '.join(_COLUMNS)}; it lacks {', '.join(lacking)}"
                raise ConfigError([Problem(str(file), 1, 1, "", message)])
            return [(reader.line_num, row) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        why = error.strerror if isinstance(error, OSError) else str(error)
        raise ConfigError([Problem(str(file), 0, 0, "", f"cannot be read: {why}")]) from error


def write_ends(ends: SquareEnds, file: Path) -> None:
    """Write ends so that `read_ends` reads them.

    Raises:
        ConfigError: the file cannot be written.
    """
    try:
        with file.open("w", encoding="utf-8", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow(_COLUMNS)
            writer.writerows((way, f"{x_m:.4f}", f"{y_m:.4f}") for way in WAYS for x_m, y_m in ends.of(way))
    except OSError as error:
        raise ConfigError([Problem(str(file), 0, 0, "", f"cannot be written: {error.strerror}")]) from error
