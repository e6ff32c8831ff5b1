"""Progress of a run: a live table on a terminal, one line for each event elsewhere."""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import dataclass
from typing import Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from eal_actors.cli.options import GlobalOptions
from eal_actors.cli.output import counted, new_table, print_line
from eal_actors.cli.run_keys import LEGEND, keys_work
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.log import configure_logging
from eal_actors.scenario.report import events

STYLES = {
    "done": "green",
    "failed": "bold red",
    **dict.fromkeys(("dropped", "aborted", "replaced", "skipped"), "yellow"),
    **dict.fromkeys(("stopped", "spare"), "dim"),
    "running": "cyan",
    "paused": "magenta",
}
"""Rich styles of outcomes and states."""

_PRINTED = (
    events.LogLine,
    events.RobotDropped,
    events.RobotLost,
    events.RobotReturned,
    events.RobotReplaced,
    events.RunContinued,
)  # scroll above the live table
_MOST_NAMES = 6
_OTHER_LINES = 6  # lines of the terminal that hold no robot's row
_REFRESHES_PER_S = 8


class LineProgress:
    """Progress as one line for each event."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exc_info: object) -> None:
        """Do nothing: every line is printed already."""

    def on_event(self, event: events.RunEvent) -> None:
        """Print an event. Thread: the run's."""
        if line := event_line(event):
            print_line(self._console, Text(f"{event.time_s:8.2f} s  ").append(line))


def event_line(event: events.RunEvent) -> Text | None:
    """Return the line of an event, without its time; None if it has none."""
    match event:
        case events.RunStarted():
            names = ", ".join(event.robots[:_MOST_NAMES]) + (", ..." if len(event.robots) > _MOST_NAMES else "")
            return Text(f"{event.scenario} on {event.fleet}: {counted(len(event.robots), 'robot')} ({names})")
        case events.RunContinued():
            return Text(f"continued at steps[{event.first_step}]")
        case events.RunPaused():
            return Text("paused", style=STYLES["paused"])
        case events.RunResumed():
            return Text("one step for each robot" if event.is_single_step else "resumed")
        case events.RobotDropped():
            return Text.assemble(f"{event.robot}  ", ("dropped", STYLES["dropped"]), f": {event.error.message}")
        case events.RobotLost():
            return Text.assemble(f"{event.robot}  ", ("lost", STYLES["dropped"]), f": {event.error.message}")
        case events.RobotReturned():
            return Text(f"{event.robot}  is back")
        case events.RobotReplaced():
            words = f" by {event.by}: {event.error.message}"
            return Text.assemble(f"{event.robot}  ", ("replaced", STYLES["replaced"]), words)
        case events.Signalled():
            return Text(f"{_robot_prefix(event.robot)}signal {event.name}")
        case events.LogLine():
            return Text(f"{_robot_prefix(event.robot)}{event.text}")
        case events.RunEnded(report=report):
            return Text.assemble(f"{report.scenario} ", (report.outcome, STYLES[report.outcome]))
    return _step_line(event)


def _step_line(event: events.RunEvent) -> Text | None:
    match event:
        case events.StepStarted():
            return Text(f"{_robot_prefix(event.robot)}{event.label}")
        case events.StepEnded(record=record):
            explained = ("failed", "skipped") if record.robot is not None else ("failed", "skipped", "aborted")
            reason = f": {record.error.message}" if record.error and record.outcome in explained else ""
            return Text.assemble(
                f"{_robot_prefix(record.robot)}{record.label}  ",
                (record.outcome, STYLES[record.outcome]),
                f" after {record.end_s - record.start_s:.2f} s{reason}",
            )
        case events.StepRetried():
            retry = f"attempt {event.attempt} failed, retrying: {event.error.message}"
            return Text(f"{_robot_prefix(event.robot)}{event.label}  {retry}", style="yellow")
        case events.StartedTogether(start=start):
            skew = "some did not start" if start.skew_s is None else f"skew {start.skew_s * 1000:.1f} ms"
            return Text(f"{len(start.begins)} robots started together: {skew}")
    return None


def _robot_prefix(robot: str | None) -> str:
    return f"{robot}  " if robot is not None else ""


@dataclass
class _RobotRow:
    """A robot's row of the live table."""

    state: str = "waiting"
    label: str = ""
    since_s: float | None = None
    calls: int = 0


class LiveProgress:
    """Progress as a table of the robots, updated in place; log lines scroll above it.

    Thread: the run's thread calls `on_event`; Rich's own thread renders the table.
    """

    def __init__(self, console: Console, clock: Clock, options: GlobalOptions) -> None:
        self._console = console
        self._clock = clock
        self._options = options
        self._lock = threading.Lock()
        self._rows: dict[str, _RobotRow] = {}
        self._title = ""
        self._calls = 0
        self._is_paused = False
        self._has_keys = keys_work()
        self._start_s = clock.now()
        self._end_s: float | None = None
        self._live = Live(
            console=console, get_renderable=self._render, refresh_per_second=_REFRESHES_PER_S, transient=True
        )

    def __enter__(self) -> Self:
        self._live.start()
        configure_logging(self._options.log_format, self._options.log_level)  # Live replaced stderr
        return self

    def __exit__(self, *_exc_info: object) -> None:
        self._live.stop()
        configure_logging(self._options.log_format, self._options.log_level)

    def on_event(self, event: events.RunEvent) -> None:
        """Update the table. Thread: the run's."""
        with self._lock:
            self._update(event)
        if isinstance(event, _PRINTED) and (line := event_line(event)):
            print_line(self._console, line)

    def _update(self, event: events.RunEvent) -> None:
        match event:
            case events.RunStarted() | events.RunContinued():
                self._start_s = self._clock.now() - event.time_s
                self._title = f"{event.scenario} on {event.fleet}"
                self._calls = event.calls
                self._rows = {name: _RobotRow() for name in event.robots}
            case events.StepStarted(robot=str(who)):
                row = self._rows[who]
                row.state, row.label, row.since_s = "running", event.label, event.time_s
            case events.StepEnded(record=record) if record.robot is not None:
                row = self._rows[record.robot]
                row.state = "waiting" if record.outcome in ("done", "skipped", "stopped") else record.outcome
                row.since_s = None
                row.calls += record.is_call
            case events.RobotReplaced():
                self._rows[event.robot].state = "replaced"
            case events.RunPaused() | events.RunResumed():
                self._is_paused = isinstance(event, events.RunPaused) or event.is_single_step
            case events.RobotDropped():
                self._rows[event.robot].state = "dropped"
            case events.RunEnded(report=report):
                self._end_s = event.time_s
                if report.outcome == "done":
                    self._calls = sum(row.calls for row in self._rows.values())  # the plan only estimated them
                for name, robot in report.robots.items():
                    self._rows[name].state, self._rows[name].since_s = robot.outcome, None

    def _render(self) -> RenderableType:
        with self._lock:
            now_s = self._end_s if self._end_s is not None else self._clock.now() - self._start_s
            return Group(self._headline(now_s), "", *self._robots(now_s))

    def _headline(self, now_s: float) -> RenderableType:
        done = sum(row.calls for row in self._rows.values())
        line = Table.grid(padding=(0, 2))
        line.add_row(
            Text(self._title, style="bold"),
            ProgressBar(total=max(self._calls, done, 1), completed=done, width=24, complete_style="cyan"),
            f"{done}/{max(self._calls, done)} calls",
            Text(f"{now_s:.1f} s", style="dim"),
            Text("paused" if self._is_paused else "", style=STYLES["paused"]),
            Text(LEGEND if self._has_keys else "", style="dim"),
        )
        return line

    def _robots(self, now_s: float) -> list[RenderableType]:
        """Return the table of the robots, busy ones first if not all fit, and a line that counts the others."""
        room = max(3, self._console.height - _OTHER_LINES)
        names = list(self._rows)
        if len(names) > room:
            names.sort(key=lambda name: self._rows[name].state != "running")  # stable
        table = new_table("robot", "state", "calls", "step", "since")
        for column in table.columns:
            column.no_wrap, column.overflow = True, "ellipsis"
        for name in names[:room]:
            row = self._rows[name]
            since = "" if row.since_s is None else f"{now_s - row.since_s:.1f} s"
            table.add_row(name, Text(row.state, style=STYLES.get(row.state, "dim")), str(row.calls), row.label, since)
        others = Counter(self._rows[name].state for name in names[room:])
        if not others:
            return [table]
        counts = ", ".join(f"{number} {state}" for state, number in sorted(others.items()))
        return [table, Text(f"and {counted(len(names) - room, 'robot')} more: {counts}", style="dim")]


def new_progress(console: Console, fleet: Fleet, options: GlobalOptions) -> LiveProgress | LineProgress:
    """Return the live table on a terminal, lines elsewhere."""
    if console.file.isatty() and not console.is_dumb_terminal:
        return LiveProgress(console, fleet.clock, options)
    return LineProgress(console)
