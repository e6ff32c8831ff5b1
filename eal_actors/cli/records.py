"""`eal report`, `eal diff` and `eal replay`: describe a finished run, compare two runs, and replay one."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import islice, zip_longest
from pathlib import Path
from typing import Annotated, Any, Final

import typer
import yaml
from rich.text import Text

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.fleets import read_fleet
from eal_actors.cli.options import JsonOption
from eal_actors.cli.output import counted, new_table, print_line, stderr, stdout, write_json
from eal_actors.cli.replay_service import serve_replay
from eal_actors.cli.run_options import parse_rate
from eal_actors.kernel.errors import ConfigError, ScenarioError, writing
from eal_actors.kernel.lock_step import MAX, Rate
from eal_actors.kernel.log import get_logger
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.manifest import replaying_plugin
from eal_actors.recording import (
    Difference,
    RunFolder,
    compare_runs,
    kept_world,
    path_deviations,
    render_difference,
    render_report,
)
from eal_actors.recording.mcap_file import RECORD_FILE
from eal_actors.recording.provenance import FLEET, kept_scenario
from eal_actors.recording.recorded_run import RecordedRun

RunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="The run's folder.")]

_REPORT: Final = "report.html"
_REPLAY: Final = "replay.yaml"
_MOST_SHOWN: Final = 20
_TRIPS: Final = ("go_to", "visit", "formation")  # a `go_to` to coordinates is a command


def report_run(
    run: RunArgument,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="The page; default: RUN/report.html.")] = None,
    show: Annotated[bool, typer.Option("--show", help="Open the page in a browser.")] = False,
) -> None:
    """Write an HTML page about a run: paths, a time line of each robot, durations of steps, frames and errors.

    The page is one file that needs no server and no network.
    """
    with reading_run():
        page = render_report(RunFolder.open(run), kept_world(run))
    file = out or _own_file(run / _REPORT)
    _write_text(file, page)
    print_line(stdout(), str(file))
    if show:
        typer.launch(str(file))


def diff_runs(
    left: Annotated[Path, typer.Argument(metavar="RUN", help="A run's folder.")],
    right: Annotated[Path, typer.Argument(metavar="RUN", help="Another run's folder.")],
    tolerance: Annotated[float, typer.Option(min=0.0, help="Allowed difference of numbers, in their own units.")] = 0.0,
    page: Annotated[Path | None, typer.Option(metavar="FILE", help="Write an HTML page with both trails.")] = None,
    as_json: JsonOption = False,
) -> None:
    """List the differences between two runs: a summary, then those in events, poses and saved data.

    Two runs of a scenario with the same seed at `--rate max` are equal. Fields that begin with wall_ or host_ are not
    compared. The exit code is 1 if the runs differ.
    """
    with reading_run():
        runs = RunFolder.open(left), RunFolder.open(right)
        found = list(compare_runs(*runs, tolerance))
        if page is not None:
            _write_text(page, render_difference(*runs, kept_world(left)))
        if as_json:
            write_json([{"where": one.where, "left": one.left, "right": one.right} for one in found])
        else:
            if found:
                _print_comparison(*runs)
            _print_differences(found)
    if page is not None:
        print_line(stderr() if as_json else stdout(), f"html: {page}", "dim")
    if found:
        raise typer.Exit(ExitCode.FAILED)


def _print_comparison(left: RunFolder, right: RunFolder) -> None:
    """Print outcomes, durations and the deviations of the paths, rounded."""
    out = stdout()
    for run in (left, right):
        report = run.summary
        facts = "unfinished" if report is None else f"{report.outcome} after {report.duration_s:.2f} s"
        print_line(out, f"{run.path.name}: {facts}")
    for one in path_deviations(left, right):
        apart = f"at most {one.most_m:.2f} m apart, at {one.most_s:.1f} s; {one.end_m:.2f} m at the end"
        print_line(out, f"{one.robot}: {apart}")


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
    rate: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBER|max",
            show_default="that of the run",
            help="Recorded seconds per real second; max is as fast as possible.",
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="The fleet file; default: RUN/replay.yaml.")] = None,
    port: Annotated[int, typer.Option(min=1, max=65535, help="With --serve: port of the first robot.")] = 50000,
    show: Annotated[
        bool | None,
        typer.Option(
            "--show/--no-show",
            show_default="in a terminal, without the other options",
            help="Open the run's page in a browser, whose player replays it. --show writes no fleet file.",
        ),
    ] = None,
) -> None:
    """Replay a recorded run in a browser, and to controllers as if its robots were there.

    The page is that of `eal report`: its player shows map, cameras, values and steps at any time of the run.

    The command also writes a fleet file whose robots have the names, types and tags of the recorded ones. Use it with
    any command or program in place of the original one. Sensors return the recorded values. Commands must come in the
    recorded order; each takes as long as recorded, and fails if it failed then.
    """
    is_plain = not (serve or loop or rate or out)
    if show or (show is None and is_plain and stdout().is_terminal):
        report_run(run, None, show=True)
    if show:
        return
    chosen = parse_rate(rate)
    if serve and chosen == MAX:
        raise typer.BadParameter("max is not possible with --serve: the network runs in real time", param_hint="--rate")
    with reading_run():
        recorded = RecordedRun.open(run / RECORD_FILE)
        fleet = _replay_fleet(recorded, run, rate=chosen, loop=loop, port=port if serve else None)
        file = out or _own_file(run / _REPLAY)
        following = list(_next_lines(run, fleet, file))
    _write_text(file, yaml.safe_dump(fleet, sort_keys=False, allow_unicode=True))
    print_line(stdout(), f"{file}: {counted(len(recorded.infos), 'robot')}, {recorded.duration_s:.1f} s")
    for line in following:
        print_line(stdout(), line)
    if serve:
        robots = list(recorded.infos)
        serve_replay(read_fleet(file, robots), robots, recorded.duration_s, loops=loop)


def _replay_fleet(
    recorded: RecordedRun, run: Path, *, rate: Rate | None, loop: bool, port: int | None
) -> dict[str, Any]:
    """Return the content of a fleet file; without a rate, that of the run, or real time for robots on the network."""
    kept = _kept_fleet(run)
    types: dict[str, Any] = {}
    robots: dict[str, Any] = {}
    player = replaying_plugin().name
    for number, name in enumerate(recorded.infos):
        robots[name] = {"plugins": {player: {"record": str(run.resolve() / RECORD_FILE), "loop": loop}}}
        robot = kept.robots.get(name) if kept is not None else None
        if robot is not None:
            for inner, base in zip_longest(robot.types, robot.types[1:]):
                types[inner] = {} if base is None else {"type": base}
            robots[name] |= {"type": robot.type} if robot.type is not None else {}
            robots[name] |= {"tags": list(robot.tags), "timeout_s": robot.timeout_s}
        if port is not None:
            robots[name]["address"] = f"tcp/127.0.0.1:{port + number}"
    fleet = recorded.content.metadata.get("run", {}).get("fleet", player)
    rate = rate or (kept.rate if kept is not None and (port is None or kept.rate != MAX) else 1.0)
    same = {} if kept is None else {"seed": kept.seed, "python_steps": list(kept.python_steps)}
    return {"version": 1, "name": fleet, **same, "clock": {"rate": rate}, "types": types, "robots": robots}


def _kept_fleet(run: Path) -> FleetConfig | None:
    """Return the fleet of a run; None if its copy is missing or has become invalid."""
    try:
        return EALConfigManager.load(run / FLEET, environment={}).fleet
    except ConfigError as error:
        get_logger().warning("the robots get no types and tags: the run's fleet file is invalid", reason=str(error))
        return None


def _next_lines(run: Path, fleet: Mapping[str, Any], file: Path) -> Iterator[Text]:
    """Yield the commands that run the scenario of a run on its record, or why it cannot."""
    if planned := _planned_trips(run):
        yield Text(f"the scenario cannot run on it: the paths of its {planned} are not in a record", "yellow")
        return
    for module in _python_modules(run, fleet):
        yield Text(f"first: {shlex.join(['cp', str(module), str(file.parent)])}", "dim")
    yield Text(f"next: {shlex.join(_next_command(run, file))}", "dim")


def _next_command(run: Path, fleet: Path) -> list[str]:
    """Return the command that runs the scenario of a run again."""
    scenario = kept_scenario(run)
    report = RunFolder.open(run).summary
    given = report.parameters.items() if report is not None else ()
    texts = [f"{name}={value if isinstance(value, str) else json.dumps(value)}" for name, value in given]
    return ["eal", "run", str(scenario), "--fleet", str(fleet), *(word for text in texts for word in ("--set", text))]


def _planned_trips(run: Path) -> str:
    """Return the kinds of steps of a run that planned the paths of robots, which need a world to be planned again."""
    report = RunFolder.open(run).summary
    steps = report.steps if report is not None else ()
    return ", ".join(dict.fromkeys(step.kind for step in steps if step.kind in _TRIPS and step.command is None))


def _python_modules(run: Path, fleet: Mapping[str, Any]) -> list[Path]:
    """Return the modules of python steps that are beside the fleet file of a run, where a run looks for them."""
    report = RunFolder.open(run).summary
    folder = Path(report.fleet_file).parent if report is not None else run
    names = dict.fromkeys(step.partition(":")[0] for step in fleet.get("python_steps", ()))
    return [file for name in names if (file := folder / f"{name}.py").is_file()]


@contextmanager
def reading_run() -> Iterator[None]:
    """Convert errors of reading a run. Raises BadParameter if the run cannot be read."""
    try:
        yield
    except ScenarioError as error:
        raise typer.BadParameter(str(error), param_hint="'RUN'") from error
    except OSError as error:
        raise typer.BadParameter(f"{error.filename} cannot be read: {error.strerror}", param_hint="'RUN'") from error


def _own_file(file: Path) -> Path:
    """Return a file of a run's folder, without the link in its place: that of a stranger could lead to any file."""
    with writing(file):
        if file.is_symlink():
            file.unlink()
    return file


def _write_text(file: Path, text: str) -> None:
    with writing(file):
        file.write_text(text, encoding="utf-8")
