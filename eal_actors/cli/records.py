"""`eal report`, `eal diff` and `eal replay`: describe a finished run, compare two runs, and replay one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, Final

import typer
import yaml
from rich.text import Text

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.fleets import read_fleet
from eal_actors.cli.interrupts import handle_signals
from eal_actors.cli.options import JsonOption
from eal_actors.cli.output import new_table, print_line, stdout, write_json
from eal_actors.facade.service import RobotService
from eal_actors.kernel.clock import REAL_TIME, new_waiter
from eal_actors.kernel.errors import ConfigError, Problem, ScenarioError
from eal_actors.managers.manifest import replaying_plugin
from eal_actors.recording import Difference, RunFolder, compare_runs, kept_world, render_report
from eal_actors.recording.mcap_file import RECORD_FILE
from eal_actors.recording.recorded_run import RecordedRun

RunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="The run's folder.", show_default=False)]

_REPORT: Final = "report.html"
_REPLAY: Final = "replay.yaml"
_MOST_SHOWN: Final = 20


def report_run(
    run: RunArgument,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", show_default=False, help="The page; default: RUN/report.html.")
    ] = None,
    show: Annotated[bool, typer.Option("--show", help="Open the page in a browser.")] = False,
) -> None:
    """Write an HTML page about a run: paths, a time line of each robot, durations of calls, frames and errors.

    The page is one file that needs no server and no network.
    """
    with _reading():
        page = render_report(RunFolder.open(run), kept_world(run))
    file = out or run / _REPORT
    _write_text(file, page)
    print_line(stdout(), str(file))
    if show:
        typer.launch(str(file))


def diff_runs(
    left: Annotated[Path, typer.Argument(metavar="RUN", help="A run's folder.", show_default=False)],
    right: Annotated[Path, typer.Argument(metavar="RUN", help="Another run's folder.", show_default=False)],
    tolerance: Annotated[float, typer.Option(min=0.0, help="Allowed difference of numbers, in their own units.")] = 0.0,
    as_json: JsonOption = False,
) -> None:
    """List the differences between two runs: in events, poses and saved data.

    Two runs of a scenario with the same seed at `--rate max` are equal. Fields that begin with wall_ or host_ are not
    compared. The exit code is 1 if the runs differ.
    """
    with _reading():
        found = list(compare_runs(RunFolder.open(left), RunFolder.open(right), tolerance))
    if as_json:
        write_json([{"where": one.where, "left": one.left, "right": one.right} for one in found])
    else:
        _print_differences(found)
    if found:
        raise typer.Exit(ExitCode.FAILED)


def _print_differences(found: list[Difference]) -> None:
    out = stdout()
    if not found:
        out.print("no difference")
        return
    table = new_table("where", "left", "right")
    for one in islice(found, _MOST_SHOWN):
        table.add_row(Text(one.where), Text(one.left), Text(one.right))
    out.print(table)
    if len(found) > _MOST_SHOWN:
        out.print(f"and {len(found) - _MOST_SHOWN} more; --json lists all")


def replay_run(
    run: RunArgument,
    serve: Annotated[bool, typer.Option("--serve", help="Serve its robots on this machine until Ctrl-C.")] = False,
    loop: Annotated[bool, typer.Option("--loop", help="Start again at the end.")] = False,
    rate: Annotated[float, typer.Option(min=0.001, help="Recorded seconds per real second.")] = 1.0,
    port: Annotated[int, typer.Option(min=1, max=65535, help="With --serve: port of the first robot.")] = 50000,
) -> None:
    """Replay a recorded run to controllers as if its robots were there.

    The command writes replay.yaml into the run's folder. Use this fleet file with any command or program in place of
    the original one. Sensors return the recorded values. Commands must come in the recorded order; each takes as long
    as recorded, and fails if it failed then.
    """
    with _reading():
        recorded = RecordedRun.open(run / RECORD_FILE)
        fleet = _replay_fleet(recorded, run, rate=rate, loop=loop, port=port if serve else None)
    file = run / _REPLAY
    _write_text(file, yaml.safe_dump(fleet, sort_keys=False))
    print_line(stdout(), f"{file}: {len(recorded.infos)} robots, {recorded.duration_s:.1f} s")
    if serve:
        _serve(file, list(recorded.infos))


def _replay_fleet(recorded: RecordedRun, run: Path, *, rate: float, loop: bool, port: int | None) -> dict[str, Any]:
    robots: dict[str, Any] = {}
    player = replaying_plugin().name
    for number, robot in enumerate(recorded.infos):
        robots[robot] = {"plugins": {player: {"record": str(run.resolve() / RECORD_FILE), "loop": loop}}}
        if port is not None:
            robots[robot]["address"] = f"tcp/127.0.0.1:{port + number}"
    name = recorded.content.metadata.get("run", {}).get("fleet", player)
    return {"version": 1, "name": name, "clock": {"rate": rate}, "robots": robots}


def _serve(file: Path, robots: list[str]) -> None:
    handle_signals()
    config = read_fleet(file, robots)
    with ExitStack() as stack:
        out = stdout()
        for robot in robots:
            service = stack.enter_context(RobotService(config, robot))
            print_line(out, f"{robot}: {', '.join(service.endpoints)}")
        try:
            REAL_TIME.wait(new_waiter(), None)
        except KeyboardInterrupt:
            out.print("leaving the network")


@contextmanager
def _reading() -> Iterator[None]:
    """Convert errors of reading a run.

    Raises:
        BadParameter: the run cannot be read.
    """
    try:
        yield
    except ScenarioError as error:
        raise typer.BadParameter(str(error), param_hint="'RUN'") from error
    except OSError as error:
        raise typer.BadParameter(f"{error.filename} cannot be read: {error.strerror}", param_hint="'RUN'") from error


def _write_text(file: Path, text: str) -> None:
    try:
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError([Problem(str(file), 0, 0, "", f"cannot be written: {error.strerror}")]) from error
