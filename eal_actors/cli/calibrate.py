"""`eal calibrate`: calibrate robots by the square test (UMBmark)."""

from __future__ import annotations

import math
import sys
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.console import Console
from rich.text import Text
from typing_extensions import override

from eal_actors.actors.handles import RobotHandle
from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.fleets import find_resource, plugin_advice, read_fleet
from eal_actors.cli.options import EalCommandGroup, JsonOption, OptionalFleetOption
from eal_actors.cli.output import counted, new_table, print_line, stderr, stdout, write_json
from eal_actors.cli.run_options import SeedOption
from eal_actors.cli.work import work_progress
from eal_actors.device.differential_base import NOMINAL, WheelCalibration
from eal_actors.device.localization.pose_estimate import Point
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.bundled import short_path
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import ArgumentError
from eal_actors.kernel.lock_step import MAX
from eal_actors.lab.calibration.calibration_file import WrittenCalibration, write_calibration
from eal_actors.lab.calibration.drive import (
    GroundTruth,
    SquareMeasurement,
    calibrate_base,
    calibration_of_base,
    drive_squares,
    has_ground_truth,
    wheelbase_of,
)
from eal_actors.lab.calibration.fit import Fit, fit_squares
from eal_actors.lab.calibration.square import WAYS, SquareEnds, Way, read_square_ends
from eal_actors.lab.fleet_edits import require_own
from eal_actors.managers.fleet_model import FleetConfig

_WAYS: Final[dict[Way, str]] = {"cw": "clockwise", "ccw": "counter-clockwise"}


@dataclass(frozen=True, slots=True)
class _SquareTest:
    """Settings of the square test. `wheelbase_m` defaults to that of the base; `ends` replaces driving.

    `keeps` says that the result is written; else a robot that others serve must not keep it either.
    """

    side_m: float
    squares: int
    wheelbase_m: float | None
    ends: SquareEnds | None
    console: Console
    keeps: bool = False


@dataclass(frozen=True, slots=True)
class _CalibrationResult:
    """The calibration of one robot.

    Attributes:
        known: the calibration that its base used before; None if the base cannot be calibrated.
        before: ends of the squares with that calibration.
        after: ends of the squares with the fitted calibration; None if there was no second run.
    """

    robot: str
    wheelbase_m: float
    known: WheelCalibration | None
    before: SquareEnds
    fit: Fit
    after: SquareEnds | None

    @property
    def is_better(self) -> bool:
        """Whether the second run has a smaller error than the first; true without a second run."""
        return self.after is None or self.after.error_m < self.before.error_m

    @property
    def factor(self) -> float | None:
        """How many times smaller the error of the second run is; None without one."""
        if self.after is None:
            return None
        return self.before.error_m / self.after.error_m if self.after.error_m else math.inf


class ManualMeasurement(SquareMeasurement):
    """Measurement by a person with a tape measure, who also puts the robot back on its mark.

    Its methods raise ArgumentError if stdin is at its end, so that nobody can answer.
    """

    def __init__(self, robot: str, clock: Clock) -> None:
        self._robot = robot
        self._clock = clock

    @override
    def prepare(self, way: Way, number: int) -> None:
        self._ask(f"{self._robot}, square {number} {_WAYS[way]}: put it on its mark, clear the floor, press Enter:")

    @override
    def measure(self, way: Way, number: int) -> Point:
        while True:
            text = self._ask(f"{self._robot}, square {number} {_WAYS[way]}: mm ahead and mm left of the mark?")
            try:
                x_mm, y_mm = map(float, text.replace(",", " ").split())
            except ValueError:
                x_mm = y_mm = math.nan
            if math.isfinite(x_mm) and math.isfinite(y_mm):
                return x_mm / 1000, y_mm / 1000
            typer.echo("Enter two numbers, such as: -12 35", err=True)

    def _ask(self, question: str) -> str:
        typer.echo(f"{question} ", nl=False, err=True)
        with self._clock.outside():
            answer = sys.stdin.readline()
        if not answer:
            error = ArgumentError(f"no answer where {self._robot} ended")
            error.add_note("Run the command on a terminal, or name a file with --ends.")
            raise error
        return answer.strip()


app = typer.Typer(cls=EalCommandGroup)


@app.callback(invoke_without_command=True)
def calibrate_robots(
    context: typer.Context,
    fleet: OptionalFleetOption = None,
    robot: Annotated[
        list[str] | None,
        typer.Option("--robot", "-r", show_default="all of the fleet", help="Name of a robot; repeatable."),
    ] = None,
    side: Annotated[float, typer.Option(min=0.2, max=20, help="Length of a side, in metres.")] = 1.0,
    runs: Annotated[int, typer.Option(min=1, max=100, help="Squares each way.")] = 5,
    seed: SeedOption = None,
    fast: Annotated[bool, typer.Option("--fast", help="As fast as possible, if all robots are simulated.")] = False,
    ends: Annotated[
        Path | None, typer.Option(metavar="CSV", help="Do not drive: read the ends of squares from this file.")
    ] = None,
    wheelbase: Annotated[
        float | None,
        typer.Option(min=0.01, max=10, show_default="that of the base", help="Nominal distance of the wheels, in m."),
    ] = None,
    write: Annotated[
        bool, typer.Option("--write", help="Write the calibration beside the fleet file, and include it there.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Measure how a robot's wheels differ from their nominal sizes, and calibrate its base (UMBmark).

    Each robot drives squares clockwise and counter-clockwise. E_b and E_d are fitted to the ends of the squares, and a
    second run with the fitted values verifies them. Simulated robots are measured automatically. For a real robot the
    command asks a person to measure, or --ends names a file with the columns way (cw or ccw), x_m (ahead) and y_m (to
    the left).

    The exit code is 1, and nothing is written, if the second run is not better than the first.
    """
    if context.invoked_subcommand is not None:
        return
    if fleet is None:
        raise typer.BadParameter("is missing: name the fleet file", param_hint="'--fleet' / '-f'")
    config = read_fleet(fleet, seed=seed, rate=MAX if fast else None)
    if write:
        require_own(config, "calibrate with that")  # fails before a robot drives
    names = list(dict.fromkeys(robot or config.robots))
    console = stderr() if as_json else stdout()
    test = _SquareTest(side, runs, wheelbase, _read_measured(ends, names), console, write)
    with Fleet(config).connect(names) as opened, plugin_advice(opened):
        results = _calibrate_all(opened, names, test)
    written = {result.robot: _write_result(config, result, side) for result in results if write and result.is_better}
    if as_json:
        write_json({"side_m": side, "robots": {result.robot: _result_as_json(result, written) for result in results}})
    else:
        _print_results(console, results)
    _print_notes(console, results, written, write=write)
    if len(results) < len(names):
        raise typer.Exit(ExitCode.INTERRUPTED)
    if not all(result.is_better for result in results):
        raise typer.Exit(ExitCode.FAILED)


def _read_measured(ends: Path | None, names: list[str]) -> SquareEnds | None:
    """Return the measured ends of the one robot, or None without a file."""
    if ends is None:
        return None
    if len(names) != 1:
        raise typer.BadParameter("needs one robot: name it with --robot", param_hint="'--ends'")
    return read_square_ends(ends)


def _calibrate_all(fleet: Fleet, names: list[str], test: _SquareTest) -> list[_CalibrationResult]:
    """Return the results of all robots; of those that are done, if Ctrl-C is pressed after the first."""
    results: list[_CalibrationResult] = []
    try:
        for name in names:
            results.append(_calibrate(fleet, name, test))  # noqa: PERF401  # what is done is kept
    except KeyboardInterrupt:
        if not results:
            raise
        print_line(test.console, f"Stopped after {counted(len(results), 'robot')} of {len(names)}.", "yellow")
    return results


def _calibrate(fleet: Fleet, name: str, test: _SquareTest) -> _CalibrationResult:
    find_resource(fleet, name, "Base")
    robot = fleet[name]
    wheelbase_m = test.wheelbase_m or wheelbase_of(robot)
    if wheelbase_m is None:
        raise ArgumentError("its Base has no wheelbase_m: give it with --wheelbase").at(name)
    known = calibration_of_base(robot)
    if test.ends is not None:
        fit = fit_squares(test.ends, test.side_m, wheelbase_m, known or NOMINAL)
        return _CalibrationResult(name, wheelbase_m, known, test.ends, fit, None)
    measurement = GroundTruth(robot) if has_ground_truth(robot) else ManualMeasurement(name, fleet.clock)
    before = _drive(robot, measurement, test, "before")
    fit = fit_squares(before, test.side_m, wheelbase_m, known or NOMINAL)
    if known is None:
        return _CalibrationResult(name, wheelbase_m, known, before, fit, None)
    result = None
    calibrate_base(robot, fit.calibration)
    try:
        after = _drive(robot, measurement, test, "after")
        result = _CalibrationResult(name, wheelbase_m, known, before, fit, after)
        return result
    finally:
        if not (test.keeps and result is not None and result.is_better):
            calibrate_base(robot, known)


def _drive(robot: RobotHandle, measurement: SquareMeasurement, test: _SquareTest, when: str) -> SquareEnds:
    """Drive the squares of one run, and show the progress on a terminal."""
    total = len(WAYS) * test.squares
    with ExitStack() as stack:
        on_done = None
        if isinstance(measurement, GroundTruth):  # a bar would hide the questions to a person
            on_done = stack.enter_context(work_progress(stderr(), "square", total, of=f" of {robot.name}, {when}"))

        def update_status(way: Way, number: int, end: Point) -> None:
            if on_done is not None:
                off_mm = [round(part * 1000) for part in end]
                on_done(f"{robot.name} {when}: {_WAYS[way]} square {number} ended at {off_mm} mm", False)

        return drive_squares(robot, measurement, test.side_m, test.squares, update_status)


def _write_result(config: FleetConfig, result: _CalibrationResult, side_m: float) -> WrittenCalibration:
    number = len(result.before.cw)
    proof = "" if result.after is None else f", and {_mm(result.after.error_m)} mm with it"
    comment = (
        f"Calibration of the wheels of {result.robot}, found by `eal calibrate`:\n"
        f"{counted(number, 'square')} each way of {side_m:g} m had an error of {_mm(result.before.error_m)} mm "
        f"before{proof}."
    )
    return write_calibration(config, result.robot, result.fit.calibration, comment)


def _print_results(console: Console, results: list[_CalibrationResult]) -> None:
    numbers = ("error before", "E_b", "E_d", "remaining", "error after", "factor")
    table = new_table("robot", *numbers, right=numbers)
    for result in results:
        after = "" if result.after is None else f"{_mm(result.after.error_m)} mm"
        factor = "" if result.factor is None else f"{result.factor:.1f}"
        table.add_row(
            Text(result.robot, style="cyan"),
            f"{_mm(result.before.error_m)} mm",
            f"{result.fit.calibration.track_factor:.4f}",
            f"{result.fit.calibration.wheel_ratio:.4f}",
            f"{_mm(result.fit.left_over_m)} mm",
            after,
            Text(factor, style="green" if result.is_better else "red"),
        )
    console.print(table)


def _print_notes(
    console: Console, results: list[_CalibrationResult], written: dict[str, WrittenCalibration], *, write: bool
) -> None:
    for result in results:
        lines = []
        if result.fit.is_doubtful:
            lines.append("the remaining error is larger than chance explains: was the robot blocked, or does it slip?")
        if not result.is_better:
            lines.append("the second run is not better: the robot needs no calibration, or more squares are needed")
        if result.known is None:
            lines.append("its Base cannot be calibrated: it has no configuration track_factor and wheel_ratio")
        for line in lines:
            print_line(console, f"{result.robot}: {line}", "yellow")
        if (files := written.get(result.robot)) is not None:
            how = ", now included by the fleet file" if files.includes else ""
            print_line(console, f"{result.robot}: {short_path(files.file)}{how}", "dim")
    if not write and any(result.known is not None for result in results):
        print_line(console, "Nothing was written; --write saves the calibration.", "dim")


def _mm(length_m: float) -> str:
    return f"{length_m * 1000:.1f}" if length_m < 0.01 else f"{length_m * 1000:.0f}"


def _result_as_json(result: _CalibrationResult, written: dict[str, WrittenCalibration]) -> dict[str, Any]:
    files = written.get(result.robot)
    return {
        "wheelbase_m": result.wheelbase_m,
        "known": None if result.known is None else result.known.model_dump(),
        "before": _ends_as_json(result.before),
        "fit": {
            **result.fit.calibration.model_dump(),
            "left_over_m": result.fit.left_over_m,
            "steps": result.fit.steps,
            "is_doubtful": result.fit.is_doubtful,
        },
        "after": None if result.after is None else _ends_as_json(result.after),
        "factor": result.factor,
        "file": None if files is None else str(files.file),
    }


def _ends_as_json(ends: SquareEnds) -> dict[str, Any]:
    return {
        "error_m": ends.error_m,
        "scatter_m": ends.scatter_m,
        **{way: [list(point) for point in ends.of(way)] for way in WAYS},
    }
