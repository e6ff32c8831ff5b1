"""`eal calibrate`: squares both ways, what they say of a robot's wheels, and the proof by squares anew (UMBmark)."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.text import Text

from eal_actors.actors.handles import RobotHandle
from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.opening import advice_on_plugins, find_resource, read_fleet
from eal_actors.cli.options import FleetOption, JsonOption
from eal_actors.cli.output import counted, new_table, short_path, stderr, stdout, write_json
from eal_actors.cli.tape_measure import Person
from eal_actors.device.differential_base import NOMINAL, WheelCalibration
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ArgumentError
from eal_actors.kernel.lock_step import MAX
from eal_actors.lab.calibration.calibration_file import Written, require_own, write_calibration
from eal_actors.lab.calibration.drive import (
    GroundTruth,
    Measurer,
    calibrate_base,
    calibration_of_base,
    drive_squares,
    has_ground_truth,
    wheelbase_of,
)
from eal_actors.lab.calibration.ends_file import read_ends
from eal_actors.lab.calibration.fit import Fit, fit_squares
from eal_actors.lab.calibration.square import WAYS, Way
from eal_actors.lab.calibration.umbmark import Point, SquareEnds
from eal_actors.managers.fleet_model import FleetConfig


@dataclass(frozen=True, slots=True)
class _Test:
    """How robots are tested.

    Attributes:
        side_m: of the squares.
        squares: each way.
        wheelbase_m: nominal; None for what the base tells.
        ends: measured already; None to drive.
        console: where progress is told.
    """

    side_m: float
    squares: int
    wheelbase_m: float | None
    ends: SquareEnds | None
    console: Console


@dataclass(frozen=True, slots=True)
class _Outcome:
    """What came of one robot.

    Attributes:
        robot: its name.
        wheelbase_m: nominal.
        known: what its base knew of its wheels; None if it cannot know anything.
        before: the ends with that.
        fit: what they say.
        after: the ends with what was fitted; None where nothing was driven again.
    """

    robot: str
    wheelbase_m: float
    known: WheelCalibration | None
    before: SquareEnds
    fit: Fit
    after: SquareEnds | None

    @property
    def is_better(self) -> bool:
        """Whether the second run has a smaller error than the first, or there was none."""
        return self.after is None or self.after.error_m < self.before.error_m


def calibrate_robots(
    fleet: FleetOption,
    robot: Annotated[
        list[str] | None,
        typer.Option("--robot", "-r", show_default="all of the fleet", help="A robot's name; may be repeated."),
    ] = None,
    side: Annotated[float, typer.Option(min=0.2, max=20, help="Length of a side, in metres.")] = 1.0,
    runs: Annotated[int, typer.Option(min=1, max=100, help="Squares each way.")] = 5,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of all randomness, in place of the fleet file's.")
    ] = None,
    fast: Annotated[bool, typer.Option("--fast", help="As fast as it goes, where all is simulated.")] = False,
    ends: Annotated[
        Path | None,
        typer.Option(metavar="CSV", show_default=False, help="Drive nothing: where squares ended, in a file."),
    ] = None,
    wheelbase: Annotated[
        float | None,
        typer.Option(
            min=0.01, max=10, show_default="what the base tells", help="Nominal distance of the wheels, in m."
        ),
    ] = None,
    write: Annotated[
        bool, typer.Option("--write", help="Write what was found beside the fleet file, and have that include it.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Find out how a robot's wheels differ from their nominal sizes, and make up for it (UMBmark).

    Each robot drives squares clockwise and the other way round, E_b and E_d are fitted to where they end, and a second
    run with both applied proves them. Simulated robots are measured and carried back by themselves; for real ones a
    person is asked, or --ends names a file with the columns way (cw or ccw), x_m (ahead) and y_m (to the left).

    Ends with 1, and writes nothing, if the second run is no better than the first.
    """
    config = read_fleet(fleet, seed=seed, rate=MAX if fast else None)
    if write:
        require_own(config)  # before anything drives
    names = robot or list(config.robots)
    if ends is not None and len(names) != 1:
        raise typer.BadParameter("the ends are of one robot: name it with --robot", param_hint="'--ends'")
    measured = None if ends is None else read_ends(ends)
    console = stderr() if as_json else stdout()
    test = _Test(side, runs, wheelbase, measured, console)
    with Fleet(config).connect(dict.fromkeys(names)) as opened, advice_on_plugins(opened):
        outcomes = [_tested(opened, name, test) for name in dict.fromkeys(names)]
    written = {done.robot: _write(config, done, side) for done in outcomes if write and done.is_better}
    if as_json:
        write_json({"side_m": side, "robots": {done.robot: _described(done, written) for done in outcomes}})
    else:
        _print(console, outcomes)
    _advise(console, outcomes, written, write=write)
    if not all(done.is_better for done in outcomes):
        raise typer.Exit(ExitCode.FAILED)


def _tested(fleet: Fleet, name: str, test: _Test) -> _Outcome:
    find_resource(fleet, name, "Base")
    robot = fleet[name]
    wheelbase_m = test.wheelbase_m or wheelbase_of(robot)
    if wheelbase_m is None:
        raise ArgumentError("does not tell its wheelbase_m: give it with --wheelbase").at(name, "Base")
    known = calibration_of_base(robot)
    if test.ends is not None:
        fit = fit_squares(test.ends, test.side_m, wheelbase_m, known or NOMINAL)
        return _Outcome(name, wheelbase_m, known, test.ends, fit, None)
    measurer: Measurer = GroundTruth(robot) if has_ground_truth(robot) else Person(name, fleet.clock)
    before = _driven(robot, measurer, test, "before")
    fit = fit_squares(before, test.side_m, wheelbase_m, known or NOMINAL)
    if known is None:
        return _Outcome(name, wheelbase_m, known, before, fit, None)
    calibrate_base(robot, fit.calibration)
    return _Outcome(name, wheelbase_m, known, before, fit, _driven(robot, measurer, test, "after"))


def _driven(robot: RobotHandle, measurer: Measurer, test: _Test, when: str) -> SquareEnds:
    """Drive the squares of one run, and tell how far it is where somebody looks."""
    total = len(WAYS) * test.squares
    with ExitStack() as stack:
        status = None
        if test.console.is_terminal and isinstance(measurer, GroundTruth):  # a person is asked on the same lines
            status = stack.enter_context(test.console.status(f"{robot.name} {when}"))

        def tell(way: Way, number: int, end: Point) -> None:
            done = number + (test.squares if way == WAYS[1] else 0)
            if status is not None:
                off_mm = [round(part * 1000) for part in end]
                status.update(f"{robot.name} {when}: {done} of {total} squares; {way} ended at {off_mm} mm")

        return drive_squares(robot, measurer, test.side_m, test.squares, tell)


def _write(config: FleetConfig, done: _Outcome, side_m: float) -> Written:
    """Write what was found of one robot."""
    number = len(done.before.cw)
    proof = "" if done.after is None else f", and {_mm(done.after.error_m)} mm with this"
    comment = (
        f"How the wheels of {done.robot} differ from nominal ones, found by `eal calibrate`:\n"
        f"{counted(number, 'square')} each way of {side_m:g} m were off by {_mm(done.before.error_m)} mm before{proof}."
    )
    return write_calibration(config, done.robot, done.fit.calibration, comment)


def _print(console: Console, outcomes: list[_Outcome]) -> None:
    table = new_table("robot", "error before", "E_b", "E_d", "left over", "error after", "factor")
    for column in table.columns[1:]:
        column.justify = "right"
    for done in outcomes:
        after = "" if done.after is None else f"{_mm(done.after.error_m)} mm"
        factor = "" if done.after is None else f"{done.before.error_m / done.after.error_m:.1f}"
        table.add_row(
            Text(done.robot, style="cyan"),
            f"{_mm(done.before.error_m)} mm",
            f"{done.fit.calibration.track_factor:.4f}",
            f"{done.fit.calibration.wheel_ratio:.4f}",
            f"{_mm(done.fit.left_over_m)} mm",
            after,
            Text(factor, style="green" if done.is_better else "red"),
        )
    console.print(table)


def _advise(console: Console, outcomes: list[_Outcome], written: dict[str, Written], *, write: bool) -> None:
    """Tell what was written, and what to look at."""
    for done in outcomes:
        lines = []
        if done.fit.is_doubtful:
            lines.append("more is left over than chance explains: was it blocked, or does it slip?")
        if not done.is_better:
            lines.append("the second run is no better: nothing is gained by a calibration, or more squares are needed")
        if done.known is None:
            lines.append("its Base cannot be calibrated: no track_factor and wheel_ratio among its configuration")
        for line in lines:
            console.print(Text(f"{done.robot}: {line}", style="yellow"), soft_wrap=True)
        if (files := written.get(done.robot)) is not None:
            how = ", which the fleet file now includes" if files.includes else ""
            console.print(Text(f"{done.robot}: {short_path(files.file)}{how}", style="dim"), soft_wrap=True)
    if not write:
        console.print(Text("Nothing was written; --write keeps what was found.", style="dim"), soft_wrap=True)


def _mm(length_m: float) -> str:
    return f"{length_m * 1000:.1f}" if length_m < 0.01 else f"{length_m * 1000:.0f}"


def _described(done: _Outcome, written: dict[str, Written]) -> dict[str, Any]:
    files = written.get(done.robot)
    return {
        "wheelbase_m": done.wheelbase_m,
        "known": None if done.known is None else done.known.model_dump(),
        "before": _ends(done.before),
        "fit": {
            **done.fit.calibration.model_dump(),
            "left_over_m": done.fit.left_over_m,
            "steps": done.fit.steps,
            "is_doubtful": done.fit.is_doubtful,
        },
        "after": None if done.after is None else _ends(done.after),
        "factor": None if done.after is None else done.before.error_m / done.after.error_m,
        "file": None if files is None else str(files.file),
    }


def _ends(ends: SquareEnds) -> dict[str, Any]:
    return {
        "error_m": ends.error_m,
        "scatter_m": ends.scatter_m,
        **{way: [list(point) for point in ends.of(way)] for way in WAYS},
    }
