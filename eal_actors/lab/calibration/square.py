"""The square test: kinematics of a differential base that drives a square, and the measured ends with their CSV file.

Source: J. Borenstein and L. Feng, "Measurement and Correction of Systematic Odometry Errors in Mobile Robots", IEEE
Transactions on Robotics and Automation 12 (6), 1996.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, variance
from typing import Final, Literal, TypeAlias

from eal_actors.device.differential_base import NOMINAL, WheelCalibration
from eal_actors.device.localization.pose_estimate import Point, Pose
from eal_actors.kernel.errors import ArgumentError, ConfigError, Problem, file_error, writing

Way: TypeAlias = Literal["cw", "ccw"]
"""Direction of a square: clockwise, with turns to the right, or counter-clockwise."""

WAYS: Final[tuple[Way, Way]] = ("cw", "ccw")
LEGS: Final = 4
START: Final[Pose] = (0.0, 0.0, 0.0)
_COLUMNS: Final = ("way", "x_m", "y_m")


def square_end(
    way: Way, side_m: float, wheelbase_m: float, truth: WheelCalibration, applied: WheelCalibration = NOMINAL
) -> Pose:
    """Return the pose after four sides and four quarter turns from (0, 0, 0), the first side along x.

    The base uses a calibration that may differ from the true one.
    """
    arm_m = wheelbase_m / 2
    quarter_m = math.pi / 2 * arm_m * (1.0 if way == "ccw" else -1.0)
    side = truth.travelled(*applied.counted(side_m, 0.0))
    turn = truth.travelled(*applied.counted(0.0, quarter_m))
    pose = START
    for _ in range(LEGS):
        for ahead_m, arc_m in (side, turn):
            pose = along_arc(pose, ahead_m, arc_m / arm_m)
    return pose


def along_arc(pose: Pose, ahead_m: float, turn_rad: float) -> Pose:
    """Return the pose after an arc of a length and a turn at constant curvature."""
    x_m, y_m, yaw_rad = pose
    half_rad = turn_rad / 2
    chord_m = ahead_m * math.sin(half_rad) / half_rad if half_rad else ahead_m
    heading_rad = yaw_rad + half_rad
    return x_m + chord_m * math.cos(heading_rad), y_m + chord_m * math.sin(heading_rad), yaw_rad + turn_rad


@dataclass(frozen=True, slots=True)
class SquareEnds:
    """Measured ends of squares, minus the ends by odometry: x along the first side, y to its left.

    All are in metres; `cw` are squares with turns to the right. Raises ArgumentError if one way has no squares, or a
    coordinate is not finite.
    """

    cw: Sequence[Point]
    ccw: Sequence[Point]

    def __post_init__(self) -> None:
        for way in WAYS:
            if not self.of(way):
                raise ArgumentError(f"no square {way} was measured: the test needs squares both ways")
            for number, (x_m, y_m) in enumerate(self.of(way), start=1):
                if not (math.isfinite(x_m) and math.isfinite(y_m)):
                    raise ArgumentError(f"square {number} {way} ended at x {x_m} m, y {y_m} m: not a position")

    def of(self, way: Way) -> Sequence[Point]:
        """Return the ends of one way."""
        return self.cw if way == "cw" else self.ccw

    def centre(self, way: Way) -> Point:
        """Return the centre of gravity of the ends of one way."""
        return fmean(x_m for x_m, _ in self.of(way)), fmean(y_m for _, y_m in self.of(way))

    @property
    def error_m(self) -> float:
        """E_max,syst: distance from the start to the farther one of the two centres of gravity."""
        return max(math.hypot(*self.centre(way)) for way in WAYS)

    @property
    def scatter_m(self) -> float | None:
        """Standard deviation of the centres of gravity, the larger one of both ways; None for single squares."""
        if min(len(self.of(way)) for way in WAYS) < 2:
            return None
        return math.sqrt(
            max(sum(variance(axis) for axis in zip(*self.of(way), strict=True)) / len(self.of(way)) for way in WAYS)
        )


def read_square_ends(file: Path) -> SquareEnds:
    """Read a CSV file with the columns way (cw or ccw), x_m and y_m, in any order; other columns are ignored.

    Raises ConfigError with every problem of the file.
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
        raise file_error(file, error.message) from None


def _rows(file: Path) -> Iterable[tuple[int, dict[str, str]]]:
    """Return each row with its line number; every row has the needed columns."""
    try:
        with file.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.DictReader(stream, restval="", skipinitialspace=True)
            missing = [name for name in _COLUMNS if name not in (reader.fieldnames or ())]
            if missing:
                message = f"its first line must name the columns {', '.join(_COLUMNS)}; missing: {', '.join(missing)}"
                raise ConfigError([Problem(str(file), 1, 1, "", message)])
            return [(reader.line_num, row) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise file_error(file, f"cannot be read: {reason}") from error


def write_square_ends(ends: SquareEnds, file: Path) -> None:
    """Write ends in the format of `read_square_ends`; raise ConfigError if the file cannot be written."""
    with writing(file), file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(_COLUMNS)
        writer.writerows((way, f"{x_m:.4f}", f"{y_m:.4f}") for way in WAYS for x_m, y_m in ends.of(way))
