"""Ends of squares in files."""

from __future__ import annotations

from pathlib import Path

import pytest

from eal_actors.kernel.errors import ConfigError
from eal_actors.lab.calibration.square import SquareEnds, read_square_ends, write_square_ends


def test_what_is_written_is_read(tmp_path: Path) -> None:
    ends = SquareEnds([(-0.28, 0.1), (0.0, 0.0012)], [(1.0, -2.0)])
    write_square_ends(ends, tmp_path / "ends.csv")
    assert read_square_ends(tmp_path / "ends.csv") == ends


def test_people_may_add_columns_and_spaces(tmp_path: Path) -> None:
    file = tmp_path / "ends.csv"
    file.write_text("day, way, y_m, x_m\nmonday, ccw, 0.5, 1\nmonday, cw, 0, 2\n", encoding="utf-8-sig")
    assert read_square_ends(file) == SquareEnds([(2.0, 0.0)], [(1.0, 0.5)])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("way,x_m\ncw,1\n", ":1:1: its first line must name the columns way, x_m, y_m; missing: y_m"),
        ("", ":1:1: its first line must name the columns way, x_m, y_m; missing: way, x_m, y_m"),
        ("way,x_m,y_m\nleft,1,2\n", ":2:1: way: must be cw or ccw, not 'left'"),
        ("way,x_m,y_m\ncw,1,2\nccw,one,2\n", ":3:1: x_m, y_m: must be numbers, not one, 2"),
        ("way,x_m,y_m\ncw,1\n", ":2:1: x_m, y_m: must be numbers, not 1, "),
        ("way,x_m,y_m\ncw,1,2\n", ": no square ccw was measured: the test needs squares both ways"),
        ("way,x_m,y_m\ncw,1,nan\nccw,1,2\n", ": square 1 cw ended at x 1.0 m, y nan m: not a position"),
        ("way,x_m,y_m\n\xff".encode("latin-1"), ": cannot be read: "),
    ],
)
def test_what_is_wrong_is_told_with_its_place(tmp_path: Path, text: str | bytes, says: str) -> None:
    file = tmp_path / "ends.csv"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ConfigError) as caught:
        read_square_ends(file)
    assert f"{file}{says}" in str(caught.value)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.csv: cannot be read: No such file"):
        read_square_ends(tmp_path / "none.csv")
