"""`eal ping`: measure the round trip to each robot of a fleet, and show its state."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from statistics import median
from typing import Annotated, Any

import typer
from rich.text import Text

from eal_actors.actors.combine import gather
from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import Ping, RobotState, RunningCommand
from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.fleets import read_fleet
from eal_actors.cli.options import FleetOption, JsonOption, RobotsArgument
from eal_actors.cli.output import new_table, print_line, stdout, write_json
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import EALError


@dataclass
class _PingResults:
    """The ping results of one robot.

    `address` is None for a robot that runs in its controller's process; `error` is why the last ping had no answer.
    """

    name: str
    address: str | None
    pings: list[Ping] = field(default_factory=list)
    error: EALError | None = None
    problems: list[str] = field(default_factory=list)

    @property
    def last(self) -> Ping | None:
        """The answer to the last ping; None if it had none."""
        return self.pings[-1] if self.pings and self.error is None else None

    @property
    def is_ready(self) -> bool:
        """Whether it accepts commands, apart from an emergency stop; a robot without an address counts as ready."""
        return self.address is None or (self.last is not None and self.last.state is RobotState.READY)


def ping_robots(
    fleet: FleetOption,
    robots: RobotsArgument = None,
    count: Annotated[int, typer.Option(min=1, max=10_000, help="Number of pings for each robot.")] = 10,
    as_json: JsonOption = False,
) -> None:
    """Ping each robot: show its state, the round-trip time and the offset of its clock.

    Robots without an address are not pinged: they run in the process of each controller. The exit code is 1 if a
    robot is not ready.
    """
    config = read_fleet(fleet, robots or ())
    results = [_PingResults(robot.name, robot.address) for robot in config.robots.values()]
    if remote := [entry for entry in results if entry.address is not None]:
        with Fleet(config).connect([entry.name for entry in remote]) as opened:
            for _ in range(count):
                _ping_once(opened, remote)
    if as_json:
        write_json({"fleet": config.name, "robots": [_results_as_json(entry) for entry in results]})
    else:
        _print_table(results)
    if not all(entry.is_ready for entry in results):
        raise typer.Exit(ExitCode.FAILED)


def _ping_once(fleet: Fleet, results: list[_PingResults]) -> None:
    """Ping all robots at once, except those that are known to be unreachable."""
    reached = [entry for entry in results if _is_reached(fleet[entry.name], entry)]
    answers = gather([fleet[entry.name].ping() for entry in reached], return_exceptions=True).get()
    for entry, answer in zip(reached, answers, strict=True):
        if isinstance(answer, Ping):
            entry.pings.append(answer)
            entry.error = None
        else:
            entry.error = answer
        entry.problems = [problem.message for problem in fleet[entry.name].problems]


def _is_reached(robot: RobotHandle, entry: _PingResults) -> bool:
    try:
        robot.require_started()
    except EALError as error:
        entry.error = error
        return False
    return True


def _results_as_json(entry: _PingResults) -> dict[str, Any]:
    last = entry.last
    trips = [ping.round_trip_s for ping in entry.pings]
    return {
        "name": entry.name,
        "address": entry.address,
        "ready": entry.is_ready,
        "state": _state(entry),
        "reason": None if entry.error is None else entry.error.message,
        "problems": entry.problems,
        "answers": len(trips),
        "round_trip_min_s": min(trips, default=None),
        "round_trip_median_s": median(trips) if trips else None,
        "clock_offset_s": last and last.offset_s,
        "clock_offset_error_s": last and last.offset_error_s,
        "release": last and last.release,
        "resources": last and last.resources,
        "stopped": last and last.stopped,
        "holders": {} if last is None else dict(last.holders),
        "warnings": [] if last is None else list(last.warnings),
        "not_ready": {} if last is None else dict(last.not_ready),
        "running": [] if last is None else [running.to_dict() for running in last.running],
    }


def _state(entry: _PingResults) -> str:
    if entry.address is None:
        return "local"
    return RobotState.LOST.value if entry.last is None else entry.last.state.value


def _print_table(results: list[_PingResults]) -> None:
    table = new_table("robot", "state", "min / median", "clock offset", "release", "resources")
    for entry in results:
        table.add_row(Text(entry.name, style="cyan"), _styled_state(entry), *_figures(entry))
    console = stdout()
    console.print(table)
    for entry in results:
        for note in _notes(entry):
            print_line(console, Text.assemble((entry.name, "cyan"), ": ", note))


def _styled_state(entry: _PingResults) -> Text:
    if entry.address is None:
        return Text("local", style="dim")
    if not entry.is_ready:
        return Text(_state(entry), style="bold red")
    if entry.last is not None and entry.last.stopped is not None:
        return Text("stopped", style="yellow")
    return Text(_state(entry), style="green")


def _figures(entry: _PingResults) -> tuple[str, str, str, str]:
    if (last := entry.last) is None:
        return "", "", "", ""
    trips = [ping.round_trip_s for ping in entry.pings]
    return (
        f"{_ms(min(trips))} / {_ms(median(trips))} ms",
        f"{last.offset_s:+.4f} s ± {_ms(last.offset_error_s)} ms",
        last.release,
        str(last.resources),
    )


def _notes(entry: _PingResults) -> Iterator[Text]:
    """Yield the notes below the table: errors, problems, resources that are not ready, leases and activities."""
    if entry.address is None:
        yield Text("runs in the controller's process", style="dim")
    if entry.error is not None:
        yield Text(entry.error.message, style="red")
    if entry.last is not None:
        if entry.last.stopped is not None:
            yield Text(f"emergency stop: {entry.last.stopped}", style="yellow")
        for problem in entry.problems:
            yield Text(problem, style="red")
        for warning in entry.last.warnings:
            yield Text(warning, style="yellow")
        for resource, reason in entry.last.not_ready.items():
            yield Text(f"{resource} is not ready: {reason}", style="yellow")
        for resource, holder in entry.last.holders.items():
            yield Text(f"{resource} is held by controller {holder}")
        for running in entry.last.running:
            yield Text(f"{running.resource} runs {running.command} for {running.by}{_format_progress(running)}")


def _format_progress(running: RunningCommand) -> str:
    if (progress := running.progress) is None:
        return ""
    parts = [f"{progress.fraction:.0%}"] if progress.fraction is not None else []
    return ": " + ", ".join([*parts, *([progress.text] if progress.text else [])])


def _ms(duration_s: float) -> str:
    return f"{duration_s * 1000:.2f}"
