"""The scenario step `fit_umbmark`: fit a robot's calibration to the squares that a scenario drove."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from eal_actors.device.differential_base import NOMINAL
from eal_actors.device.localization.pose_estimate import Point, Pose
from eal_actors.device.localization.pose_filter import between
from eal_actors.kernel.errors import ArgumentError, ScenarioError
from eal_actors.lab.calibration.drive import calibration_of_base, wheelbase_of
from eal_actors.lab.calibration.fit import Fit, fit_squares
from eal_actors.lab.calibration.square import (
    START,
    WAYS,
    SquareEnds,
    read_square_ends,
    write_square_ends,
)
from eal_actors.scenario.report.files import check_file_name
from eal_actors.scenario.steps.python import StepContext

NAME: Final = "umbmark"
"""Default name of the files that the step writes into the robot's folder."""


def fit_umbmark(
    context: StepContext,
    *,
    side_m: float,
    ends: Sequence[Sequence[Any]] | None = None,
    start: Sequence[float] = START,
    file: str | None = None,
    wheelbase_m: float | None = None,
    name: str = NAME,
) -> dict[str, float]:
    """Fit E_b and E_d to the ends of a robot's squares; the step belongs inside an `on`.

    Args:
        context: of the step.
        side_m: length of a side.
        ends: for each square, the way (cw or ccw), the measured end pose and, if odometry was set to 0 before the
            square, the end pose by odometry.
        start: the measured start pose of all squares.
        file: a CSV file with the columns way, x_m and y_m, instead of `ends`.
        wheelbase_m: nominal distance of the wheels; default: that of the base.
        name: name of the files that the step writes into the robot's folder: `<name>.csv` with the ends, `<name>.json`.

    Returns:
        track_factor (E_b), wheel_ratio (E_d), error_m (E_max,syst of these squares) and left_over_m.

    Raises:
        ScenarioError: the step is outside an `on`, the name leads out of the folder, or `ends` are wrong, or there is
            no wheelbase.
        ArgumentError: no base can produce these ends.
        ConfigError: the file is wrong.
    """
    if context.robot is None:
        raise ScenarioError("fit_umbmark works on one robot: put it inside an `on`")
    check_file_name(f"{name}.csv")
    robot = context.robots[context.robot]
    if (ends is None) == (file is None):
        raise ScenarioError("fit_umbmark needs either `ends` or `file`")
    measured = read_square_ends(Path(file)) if file is not None else _measured(ends or (), start)
    base_m = wheelbase_m or wheelbase_of(robot)
    if base_m is None:
        raise ScenarioError("fit_umbmark needs `wheelbase_m`: the Base has none").at(robot.name)
    fit = fit_squares(measured, side_m, base_m, calibration_of_base(robot) or NOMINAL)  # which the result replaces
    context.log(_summarize(measured, fit))
    found = {**fit.calibration.model_dump(), "error_m": measured.error_m, "left_over_m": fit.left_over_m}
    if context.directory is not None:
        folder = context.directory / robot.name
        folder.mkdir(parents=True, exist_ok=True)
        write_square_ends(measured, folder / f"{name}.csv")
        (folder / f"{name}.json").write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    return found


def _summarize(measured: SquareEnds, fit: Fit) -> str:
    doubt = "; more than chance explains" if fit.is_doubtful else ""
    return (
        f"off by {measured.error_m * 1000:.0f} mm: E_b {fit.calibration.track_factor:.4f}, "
        f"E_d {fit.calibration.wheel_ratio:.4f}, {fit.left_over_m * 1000:.0f} mm remain{doubt}"
    )


def _measured(ends: Sequence[Sequence[Any]], start: Sequence[float]) -> SquareEnds:
    """Return the ends relative to the start, minus the ends by odometry."""
    points: dict[str, list[Point]] = {way: [] for way in WAYS}
    for number, end in enumerate(ends, start=1):
        try:
            way, seen, believed = (*end, START)[:3]
            x_m, y_m, _ = between(_pose(start), _pose(seen))
            points[way].append((x_m - float(believed[0]), y_m - float(believed[1])))
        except (TypeError, ValueError, KeyError, IndexError):
            raise ScenarioError(
                f"end {number} must be [cw or ccw, [x_m, y_m, yaw_rad], [x_m, y_m, yaw_rad]], not {end!r}"
            ) from None
    try:
        return SquareEnds(points["cw"], points["ccw"])
    except ArgumentError as error:
        raise ScenarioError(error.message) from None


def _pose(parts: Sequence[Any]) -> Pose:
    x_m, y_m, *yaw_rad = (float(part) for part in parts)
    return x_m, y_m, yaw_rad[0] if yaw_rad else 0.0
