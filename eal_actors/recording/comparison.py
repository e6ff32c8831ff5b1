"""Comparison of two runs, without wall times and hosts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any, Final

from eal_actors.recording.mcap_file import DAMAGED_FILE
from eal_actors.recording.poses import PoseSample, index_at
from eal_actors.recording.run_folder import RunFolder

_IGNORED: Final = ("wall_", "host_")
"""Prefixes of keys and files that may differ between two runs of the same scenario."""
_OWN_FILES: Final = ("events.jsonl", "summary.json", "trajectory.csv", "trajectory.png", "run.mcap", "report.html")
_OF_FILES: Final = ("scenario_file", "scenario_hash", "fleet_file", "fleet")
"""Keys that name the input of a run."""
_MISSING: Final = object()


@dataclass(frozen=True, slots=True)
class Difference:
    """One difference. `where` is its place, such as `events[12].record.end_s` or `evbot2-1 at 3.200 s`."""

    where: str
    left: str
    right: str


def compare_runs(left: RunFolder, right: RunFolder, tolerance: float = 0.0) -> Iterator[Difference]:
    """Yield the differences of events, then of paths, then of saved files. Numbers may differ by the tolerance.

    Raises ScenarioError if a folder is broken.
    """
    for number, (one, other) in enumerate(zip_longest(left.events, right.events, fillvalue=_MISSING)):
        yield from _compare_values(f"events[{number}]", one, other, tolerance)
    for robot in sorted({*left.paths, *right.paths}):
        yield from _compare_paths(robot, left.paths.get(robot, []), right.paths.get(robot, []), tolerance)
    for name in sorted(_saved_files(left.path) | _saved_files(right.path)):
        one, other = left.path / name, right.path / name
        if not (one.is_file() and other.is_file()):
            yield Difference(name, *("a file" if file.is_file() else "nothing" for file in (one, other)))
        elif one.read_bytes() != other.read_bytes():
            yield Difference(name, f"{one.stat().st_size} bytes", f"{other.stat().st_size} other bytes")


@dataclass(frozen=True, slots=True)
class PathDeviation:
    """The largest distance of a robot in two runs at the same time, when that was, and the distance of their ends."""

    robot: str
    most_m: float
    most_s: float
    end_m: float


def path_deviations(left: RunFolder, right: RunFolder) -> tuple[PathDeviation, ...]:
    """Return the deviations of the robots that both runs recorded; after its end a robot is where it ended.

    Raises ScenarioError if a folder is broken.
    """
    names = [name for name in left.paths if left.paths[name] and right.paths.get(name)]
    return tuple(_deviation(name, left.paths[name], right.paths[name]) for name in names)


def _deviation(robot: str, one: Sequence[PoseSample], other: Sequence[PoseSample]) -> PathDeviation:
    times_s = sorted({sample.time_s for sample in (*one, *other)})
    apart = ((math.dist(_place(one, time_s), _place(other, time_s)), time_s) for time_s in times_s)
    most_m, most_s = max(apart, key=lambda found: found[0])
    return PathDeviation(robot, most_m, most_s, math.dist(one[-1][1:3], other[-1][1:3]))


def _place(path: Sequence[PoseSample], time_s: float) -> tuple[float, float]:
    return path[index_at(path, time_s)][1:3]


def first_difference(left: RunFolder, right: RunFolder, before_s: float = math.inf) -> Difference | None:
    """Return the first event or pose, before a time since the start, that differs, without names and hashes of files.

    Raises ScenarioError if a folder is broken.
    """
    found = [*_first_event(left, right, before_s), *_first_pose(left, right, before_s)]
    return min(found, key=lambda pair: pair[0])[1] if found else None


def _first_event(left: RunFolder, right: RunFolder, before_s: float) -> Iterator[tuple[float, Difference]]:
    of_left, of_right = (
        [_without_files(one) for one in run.events if one["time_s"] < before_s] for run in (left, right)
    )
    for one, other in zip_longest(of_left, of_right):
        if one != other:
            time_s = min(event["time_s"] for event in (one, other) if event is not None)
            values = next(_compare_values("", one or {}, other or {}, 0.0), Difference("", "", ""))
            kind = (one or other or {}).get("event", "event")
            where = f"{kind}{values.where} at {time_s:.3f} s"
            yield time_s, Difference(where, values.left if one else "nothing", values.right if other else "nothing")
            return


def _without_files(event: Mapping[str, Any]) -> dict[str, Any]:
    kept = {key: value for key, value in event.items() if key not in _OF_FILES and not key.startswith(_IGNORED)}
    if isinstance(kept.get("report"), Mapping):
        kept["report"] = _without_files(kept["report"])
    return kept


def _first_pose(left: RunFolder, right: RunFolder, before_s: float) -> Iterator[tuple[float, Difference]]:
    for robot in sorted({*left.paths, *right.paths}):
        one, other = ([pose for pose in run.paths.get(robot, []) if pose.time_s < before_s] for run in (left, right))
        for found in _compare_paths(robot, one, other, 0.0):
            yield float(found.where.rsplit(" at ", 1)[1].removesuffix(" s")), found


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
            left, right = _format_pose(sample), _format_pose(of_other)
            if left == right:  # the times differ, or the poses by less than is printed
                left, right = (repr(tuple(one)) for one in (sample, of_other))
            yield Difference(f"{robot} at {time_s:.3f} s", left, right)
            return


def _format_pose(sample: PoseSample | None) -> str:
    if sample is None:
        return "nothing"
    return f"({sample.x_m:.6f} m, {sample.y_m:.6f} m, {sample.yaw_rad:.6f} rad)"


def _saved_files(folder: Path) -> set[str]:
    files = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    return {name for name in files if name not in _OWN_FILES and not name.startswith((*_IGNORED, DAMAGED_FILE))}
