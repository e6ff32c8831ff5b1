"""The scenario step `fit_umbmark`: what the squares that a scenario drove say of its robot."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Protocol

from eal_actors.actors.handles import RobotHandle
from eal_actors.device.differential_base import NOMINAL
from eal_actors.kernel.errors import ArgumentError, ScenarioError
from eal_actors.lab.calibration.drive import calibration_of_base, wheelbase_of
from eal_actors.lab.calibration.ends_file import read_ends, write_ends
from eal_actors.lab.calibration.fit import Fit, fit_squares
from eal_actors.lab.calibration.square import START, WAYS, Pose, seen_from
from eal_actors.lab.calibration.umbmark import Point, SquareEnds
from eal_actors.scenario.report.files import check_file_name

NAME: Final = "umbmark"
"""Of the files that the step leaves in the robot's folder, unless it is told another one."""


class Context(Protocol):
    """What the step uses of its scenario."""

    @property
    def robots(self) -> Mapping[str, RobotHandle]:
        """The robots that it may use, by name."""
        ...

    @property
    def robot(self) -> str | None:
        """The robot of the `on` around it."""
        ...

    @property
    def directory(self) -> Path | None:
        """The run's folder."""
        ...

    @property
    def log(self) -> Callable[[str], None]:
        """Tells those who watch."""
        ...


def fit_umbmark(
    context: Context,
    *,
    side_m: float,
    ends: Sequence[Sequence[Any]] | None = None,
    start: Sequence[float] = START,
    file: str | None = None,
    wheelbase_m: float | None = None,
    name: str = NAME,
) -> dict[str, float]:
    """Fit E_b and E_d to where a robot's squares ended; stands inside an `on`.

    Args:
        context: of the step.
        side_m: length of a side.
        ends: of each square, the way (cw or ccw), the pose in which the robot ended, as it was measured, and, if it has
            odometry that was set to 0 before, the pose in which it believed to be.
        start: the pose from which every square began, as it was measured.
        file: a CSV file with the columns way, x_m and y_m, in place of `ends`.
        wheelbase_m: the nominal distance of the wheels; what the base tells, if left out.
        name: of the files that it leaves in the robot's folder: `<name>.csv` with the ends, and `<name>.json`.

    Returns:
        track_factor (E_b), wheel_ratio (E_d), error_m (E_max,syst of these squares) and left_over_m.

    Raises:
        ScenarioError: it stands outside an `on`, the name leads out of the folder, or `ends` or the robot lack
            something.
        ArgumentError: no base makes squares end so.
        ConfigError: the file is wrong.
    """
    if context.robot is None:
        raise ScenarioError("fit_umbmark is of one robot: it must stand inside an `on`")
    check_file_name(f"{name}.csv")
    robot = context.robots[context.robot]
    if (ends is None) == (file is None):
        raise ScenarioError("fit_umbmark needs either `ends` or `file`")
    measured = read_ends(Path(file)) if file is not None else _measured(ends or (), start)
    fit = _fit(robot, measured, side_m, wheelbase_m)
    context.log(_told(measured, fit))
    found = {**fit.calibration.model_dump(), "error_m": measured.error_m, "left_over_m": fit.left_over_m}
    if context.directory is not None:
        _keep(context.directory / robot.name, name, measured, found)
    return found


def _fit(robot: RobotHandle, measured: SquareEnds, side_m: float, wheelbase_m: float | None) -> Fit:
    """Fit what the base is told now, so that what is found takes its place."""
    base_m = wheelbase_m or wheelbase_of(robot)
    if base_m is None:
        raise ScenarioError("fit_umbmark needs `wheelbase_m`: the Base does not tell").at(robot.name)
    return fit_squares(measured, side_m, base_m, calibration_of_base(robot) or NOMINAL)


def _told(measured: SquareEnds, fit: Fit) -> str:
    doubt = "; more is left over than chance explains" if fit.is_doubtful else ""
    return (
        f"off by {measured.error_m * 1000:.0f} mm: E_b {fit.calibration.track_factor:.4f}, "
        f"E_d {fit.calibration.wheel_ratio:.4f}, {fit.left_over_m * 1000:.0f} mm left over{doubt}"
    )


def _keep(folder: Path, name: str, measured: SquareEnds, found: Mapping[str, float]) -> None:
    """Leave the ends and what was found from them in the robot's folder."""
    folder.mkdir(parents=True, exist_ok=True)
    write_ends(measured, folder / f"{name}.csv")
    (folder / f"{name}.json").write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


def _measured(ends: Sequence[Sequence[Any]], start: Sequence[float]) -> SquareEnds:
    """Return ends as they are seen from the start, less where the robot believed to be."""
    points: dict[str, list[Point]] = {way: [] for way in WAYS}
    for number, end in enumerate(ends, start=1):
        try:
            way, seen, believed = (*end, START)[:3]
            x_m, y_m, _ = seen_from(_pose(start), _pose(seen))
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
