"""Comparison of two runs, without wall times and hosts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any, Final

from eal_actors.recording.poses import PoseSample
from eal_actors.recording.run_folder import RunFolder

_IGNORED: Final = ("wall_", "host_")
"""Prefixes of keys and files that may differ between two runs of the same scenario."""
_OWN_FILES: Final = ("events.jsonl", "summary.json", "trajectory.csv", "trajectory.png", "run.mcap", "report.html")
_MISSING: Final = object()


@dataclass(frozen=True, slots=True)
class Difference:
    """One difference.

    Attributes:
        where: its place, such as `events[12].record.end_s` or `evbot2-1 at 3.200 s`.
        left: the value of the first run, as text.
        right: the value of the second run, as text.
    """

    where: str
    left: str
    right: str


def compare_runs(left: RunFolder, right: RunFolder, tolerance: float = 0.0) -> Iterator[Difference]:
    """Yield the differences of events, then of paths, then of saved files.

    Args:
        left: the first run.
        right: the second run.
        tolerance: numbers that differ by at most this are equal; in the unit of each.

    Raises:
        ScenarioError: a folder is broken.
    """
    for number, (one, other) in enumerate(zip_longest(left.events, right.events, fillvalue=_MISSING)):
        yield from _compare_values(f"events[{number}]", one, other, tolerance)
    for robot in sorted({*left.paths, *right.paths}):
        yield from _compare_paths(robot, left.paths.get(robot, []), right.paths.get(robot, []), tolerance)
    yield from _compare_files(left.path, right.path)


def _compare_values(where: str, one: Any, other: Any, tolerance: float) -> Iterator[Difference]:
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        for key in dict.fromkeys([*one, *other]):
            if not key.startswith(_IGNORED):
                values = one.get(key, _MISSING), other.get(key, _MISSING)
                yield from _compare_values(f"{where}.{key}", *values, tolerance)
    elif isinstance(one, list) and isinstance(other, list):
        for index, items in enumerate(zip_longest(one, other, fillvalue=_MISSING)):
            yield from _compare_values(f"{where}[{index}]", *items, tolerance)
    elif not _are_equal(one, other, tolerance):
        yield Difference(where, _format_value(one), _format_value(other))


def _are_equal(one: Any, other: Any, tolerance: float) -> bool:
    if _is_number(one) and _is_number(other):
        return bool(abs(one - other) <= tolerance)
    return type(one) is type(other) and bool(one == other)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _format_value(value: Any) -> str:
    if value is _MISSING:
        return "nothing"
    if isinstance(value, Mapping):
        return str(value.get("event") or dict(value))
    return repr(value)


def _compare_paths(
    robot: str, one: list[PoseSample], other: list[PoseSample], tolerance: float
) -> Iterator[Difference]:
    """Yield the first difference: the later ones mostly follow from it."""
    for sample, of_other in zip_longest(one, other):
        is_missing = sample is None or of_other is None
        if is_missing or any(abs(a - b) > tolerance for a, b in zip(sample, of_other, strict=True)):
            time_s = (sample or of_other).time_s
            yield Difference(f"{robot} at {time_s:.3f} s", _format_pose(sample), _format_pose(of_other))
            return


def _format_pose(sample: PoseSample | None) -> str:
    if sample is None:
        return "nothing"
    return f"({sample.x_m:.6f} m, {sample.y_m:.6f} m, {sample.yaw_rad:.6f} rad)"


def _compare_files(left: Path, right: Path) -> Iterator[Difference]:
    for name in sorted(_saved_files(left) | _saved_files(right)):
        one, other = left / name, right / name
        if not (one.is_file() and other.is_file()):
            yield Difference(name, *("a file" if file.is_file() else "nothing" for file in (one, other)))
        elif one.read_bytes() != other.read_bytes():
            yield Difference(name, f"{one.stat().st_size} bytes", f"{other.stat().st_size} other bytes")


def _saved_files(folder: Path) -> set[str]:
    files = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    return {name for name in files if name not in _OWN_FILES and not name.startswith(_IGNORED)}
