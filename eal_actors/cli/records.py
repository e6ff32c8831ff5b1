"""`eal report`, `eal diff` and `eal replay`: look at a run that is over, compare two, and play one again."""

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
from eal_actors.cli.interrupts import heed_signals
from eal_actors.cli.opening import read_fleet
from eal_actors.cli.options import JsonOption
from eal_actors.cli.output import new_table, stdout, write_json
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
        Path | None, typer.Option(metavar="FILE", show_default=False, help="The page; report.html in the run's folder.")
    ] = None,
    show: Annotated[bool, typer.Option("--show", help="Open it in a browser.")] = False,
) -> None:
    """Write one HTML page about a run: paths, a time line of each robot, how long calls took, frames and errors.

    It needs nothing else: no server, no network.
    """
    with _reading():
        page = render_report(RunFolder.open(run), kept_world(run))
    file = out or run / _REPORT
    _write(file, page)
    stdout().print(Text(str(file)), soft_wrap=True)
    if show:
        typer.launch(str(file))


def diff_runs(
    left: Annotated[Path, typer.Argument(metavar="RUN", help="A run's folder.", show_default=False)],
    right: Annotated[Path, typer.Argument(metavar="RUN", help="Another one's.", show_default=False)],
    tolerance: Annotated[float, typer.Option(min=0.0, help="How far numbers may be apart, in the unit of each.")] = 0.0,
    as_json: JsonOption = False,
) -> None:
    """Tell what differs between two runs: in their events, in where the robots were, and in what was saved.

    Two runs of the same scenario with the same seed at `--rate max` do not differ. What begins with wall_ or host_ may.
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
        out.print(f"and {len(found) - _MOST_SHOWN} more; --json tells all")


def replay_run(
    run: RunArgument,
    serve: Annotated[bool, typer.Option("--serve", help="Serve its robots on this machine until Ctrl-C.")] = False,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end.")] = False,
    rate: Annotated[float, typer.Option(min=0.001, help="Seconds of the record in one real second.")] = 1.0,
    port: Annotated[int, typer.Option(min=1, max=65535, help="With --serve: port of the first robot.")] = 50000,
) -> None:
    """Play a recorded run to controllers as if its robots were there.

    It writes replay.yaml into the run's folder: a fleet file that every command and program takes in place of the run's
    own. Sensors say what they said then; a command takes as long as it took, and fails as it failed, and it must be the
    one that the record has next.
    """
    with _reading():
        recorded = RecordedRun.open(run / RECORD_FILE)
        fleet = _replay_fleet(recorded, run, rate=rate, loop=loop, port=port if serve else None)
    file = run / _REPLAY
    _write(file, yaml.safe_dump(fleet, sort_keys=False))
    out = stdout()
    out.print(Text(f"{file}: {len(recorded.infos)} robots, {recorded.duration_s:.1f} s"), soft_wrap=True)
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
    heed_signals()
    config = read_fleet(file, robots)
    with ExitStack() as stack:
        out = stdout()
        for robot in robots:
            service = stack.enter_context(RobotService(config, robot))
            out.print(Text(f"{robot}: {', '.join(service.endpoints)}"), soft_wrap=True)
        try:
            REAL_TIME.wait(new_waiter(), None)
        except KeyboardInterrupt:
            out.print("leaving the network")


@contextmanager
def _reading() -> Iterator[None]:
    """Take a run that cannot be read for wrong input.

    Raises:
        BadParameter: it cannot.
    """
    try:
        yield
    except ScenarioError as error:
        raise typer.BadParameter(str(error), param_hint="'RUN'") from error
    except OSError as error:
        raise typer.BadParameter(f"{error.filename} cannot be read: {error.strerror}", param_hint="'RUN'") from error


def _write(file: Path, text: str) -> None:
    try:
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError([Problem(str(file), 0, 0, "", f"cannot be written: {error.strerror}")]) from error
