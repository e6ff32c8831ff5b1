"""Compare two runs: what differs between them beside the wall clock and the host."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any, Final

from eal_actors.recording.pose_sample import PoseSample
from eal_actors.recording.run_folder import RunFolder

_FREE: Final = ("wall_", "host_")
"""What begins so may differ between two runs of the same."""
_OWN_FILES: Final = ("events.jsonl", "summary.json", "trajectory.csv", "trajectory.png", "run.mcap", "report.html")
_MISSING: Final = object()


@dataclass(frozen=True, slots=True)
class Difference:
    """One thing that differs.

    Attributes:
        where: what it is of, such as `events[12].record.end_s` or `evbot2-1 at 3.200 s`.
        left: what the first run has, as text.
        right: what the second run has, as text.
    """

    where: str
    left: str
    right: str


def differences(left: RunFolder, right: RunFolder, tolerance: float = 0.0) -> Iterator[Difference]:
    """Yield what differs: events one by one, then where the robots were, then the files that were saved.

    Args:
        left: the first run.
        right: the second run.
        tolerance: numbers that are no farther apart count as equal; in the unit of each.

    Raises:
        ScenarioError: a folder is broken.
    """
    for number, (one, other) in enumerate(zip_longest(left.events, right.events, fillvalue=_MISSING)):
        yield from _compare(f"events[{number}]", one, other, tolerance)
    for robot in sorted({*left.paths, *right.paths}):
        yield from _compare_paths(robot, left.paths.get(robot, []), right.paths.get(robot, []), tolerance)
    yield from _compare_files(left.path, right.path)


def _compare(where: str, one: Any, other: Any, tolerance: float) -> Iterator[Difference]:
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        for key in dict.fromkeys([*one, *other]):
            if not key.startswith(_FREE):
                yield from _compare(f"{where}.{key}", one.get(key, _MISSING), other.get(key, _MISSING), tolerance)
    elif isinstance(one, list) and isinstance(other, list):
        for index, (item, item_of_other) in enumerate(zip_longest(one, other, fillvalue=_MISSING)):
            yield from _compare(f"{where}[{index}]", item, item_of_other, tolerance)
    elif not _equal(one, other, tolerance):
        yield Difference(where, _text(one), _text(other))


def _equal(one: Any, other: Any, tolerance: float) -> bool:
    if _is_number(one) and _is_number(other):
        return bool(abs(one - other) <= tolerance)
    return type(one) is type(other) and bool(one == other)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _text(value: Any) -> str:
    if value is _MISSING:
        return "nothing"
    if isinstance(value, Mapping):
        return str(value.get("event") or dict(value))
    return repr(value)


def _compare_paths(
    robot: str, one: list[PoseSample], other: list[PoseSample], tolerance: float
) -> Iterator[Difference]:
    """Yield the first sample that differs: those after it mostly follow from it."""
    for sample, of_other in zip_longest(one, other):
        if sample is None or of_other is None:
            longer = sample or of_other
            yield Difference(f"{robot} at {longer.time_s:.3f} s", _pose_text(sample), _pose_text(of_other))
            return
        if any(abs(a - b) > tolerance for a, b in zip(sample, of_other, strict=True)):
            yield Difference(f"{robot} at {sample.time_s:.3f} s", _pose_text(sample), _pose_text(of_other))
            return


def _pose_text(sample: PoseSample | None) -> str:
    if sample is None:
        return "nothing"
    return f"({sample.x_m:.6f} m, {sample.y_m:.6f} m, {sample.yaw_rad:.6f} rad)"


def _compare_files(left: Path, right: Path) -> Iterator[Difference]:
    for name in sorted(_saved(left) | _saved(right)):
        one, other = left / name, right / name
        if not (one.is_file() and other.is_file()):
            yield Difference(name, *("a file" if file.is_file() else "nothing" for file in (one, other)))
        elif one.read_bytes() != other.read_bytes():
            yield Difference(name, f"{one.stat().st_size} bytes", f"{other.stat().st_size} other bytes")


def _saved(folder: Path) -> set[str]:
    files = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    return {name for name in files if name not in _OWN_FILES and not name.startswith(_FREE)}
