"""How a run looks while it goes on: a live table on a terminal, a line for each event elsewhere."""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from eal_actors.cli.options import GlobalOptions
from eal_actors.cli.output import counted, new_table
from eal_actors.cli.run_keys import LEGEND, keys_work
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.log import configure_logging
from eal_actors.scenario import (
    LogLine,
    RobotDropped,
    RobotReplaced,
    RunContinued,
    RunEnded,
    RunEvent,
    RunPaused,
    RunResumed,
    RunStarted,
    Signalled,
    StartedTogether,
    StepEnded,
    StepRetried,
    StepStarted,
)

STYLES = {
    "done": "green",
    "failed": "bold red",
    **dict.fromkeys(("dropped", "aborted", "replaced", "skipped"), "yellow"),
    **dict.fromkeys(("stopped", "spare"), "dim"),
    "running": "cyan",
    "paused": "magenta",
}
"""How outcomes and states look."""

_TOLD = (LogLine, RobotDropped, RobotReplaced, RunContinued)
"""What scrolls by above the live table."""
_MOST_NAMES = 6
_LINES_AROUND = 6  # of the terminal's height, for what is not a robot's row
_REFRESHES_PER_S = 8


class Progress(Protocol):
    """Shows a run, between `with` and its end."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None: ...

    def hear(self, event: RunEvent) -> None:
        """Take notice of an event. Thread: the run's."""
        ...


def new_progress(console: Console, fleet: Fleet, options: GlobalOptions) -> Progress:
    """Return what suits the console."""
    if console.file.isatty() and not console.is_dumb_terminal:
        return LiveProgress(console, fleet.clock, options)
    return PlainProgress(console)


class PlainProgress:
    """Writes one line for each event."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Nothing is left to do: every line is out."""

    def hear(self, event: RunEvent) -> None:
        """See Progress."""
        if line := event_line(event):
            self._console.print(Text(f"{event.time_s:8.2f} s  ").append(line), soft_wrap=True)


def event_line(event: RunEvent) -> Text | None:
    """Return an event in one line, without its time."""
    match event:
        case RunStarted():
            names = ", ".join(event.robots[:_MOST_NAMES]) + (", ..." if len(event.robots) > _MOST_NAMES else "")
            return Text(f"{event.scenario} on {event.fleet}: {counted(len(event.robots), 'robot')} ({names})")
        case RunContinued():
            return Text(f"goes on at steps[{event.first_step}]")
        case RunPaused():
            return Text("paused", style=STYLES["paused"])
        case RunResumed():
            return Text("one step each" if event.is_single_step else "goes on")
        case RobotDropped():
            return Text.assemble(f"{event.robot}  ", ("dropped", STYLES["dropped"]), f": {event.error.message}")
        case RobotReplaced():
            words = f" by {event.by}: {event.error.message}"
            return Text.assemble(f"{event.robot}  ", ("replaced", STYLES["replaced"]), words)
        case Signalled():
            return Text(f"{_who(event.robot)}signal {event.name}")
        case LogLine():
            return Text(f"{_who(event.robot)}{event.text}")
        case RunEnded(report=report):
            return Text.assemble(f"{report.scenario} ", (report.outcome, STYLES[report.outcome]))
    return _step_line(event)


def _step_line(event: RunEvent) -> Text | None:
    match event:
        case StepStarted():
            return Text(f"{_who(event.robot)}{event.label}")
        case StepEnded(record=record):
            told = ("failed", "skipped") if record.robot is not None else ("failed", "skipped", "aborted")
            why = f": {record.error.message}" if record.error and record.outcome in told else ""
            return Text.assemble(
                f"{_who(record.robot)}{record.label}  ",
                (record.outcome, STYLES[record.outcome]),
                f" after {record.end_s - record.start_s:.2f} s{why}",
            )
        case StepRetried():
            what = f"attempt {event.attempt} failed, trying again: {event.error.message}"
            return Text(f"{_who(event.robot)}{event.label}  {what}", style="yellow")
        case StartedTogether(start=start):
            skew = "not all have begun" if start.skew_s is None else f"skew {start.skew_s * 1000:.1f} ms"
            return Text(f"{len(start.begins)} robots began together: {skew}")
    return None


def _who(robot: str | None) -> str:
    return f"{robot}  " if robot is not None else ""


@dataclass
class _Row:
    """What the live table shows of a robot."""

    state: str = "waiting"
    label: str = ""
    since_s: float | None = None
    calls: int = 0


class LiveProgress:
    """Shows a table of the robots that changes in place; what is logged scrolls by above it.

    Thread: events come from the run's thread, the picture is drawn by Rich's own.
    """

    def __init__(self, console: Console, clock: Clock, options: GlobalOptions) -> None:
        self._console = console
        self._clock = clock
        self._options = options
        self._lock = threading.Lock()
        self._rows: dict[str, _Row] = {}
        self._title = ""
        self._calls = 0
        self._is_paused = False
        self._has_keys = keys_work()
        self._start_s = clock.now()
        self._end_s: float | None = None
        self._live = Live(
            console=console, get_renderable=self._picture, refresh_per_second=_REFRESHES_PER_S, transient=True
        )

    def __enter__(self) -> Self:
        self._live.start()
        configure_logging(self._options.log_format, self._options.log_level)  # to the stderr that Live put in place
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._live.stop()
        configure_logging(self._options.log_format, self._options.log_level)

    def hear(self, event: RunEvent) -> None:
        """See Progress."""
        with self._lock:
            self._note(event)
        if isinstance(event, _TOLD) and (line := event_line(event)):
            self._console.print(line, soft_wrap=True)

    def _note(self, event: RunEvent) -> None:
        match event:
            case RunStarted() | RunContinued():
                self._start_s = self._clock.now() - event.time_s
                self._title = f"{event.scenario} on {event.fleet}"
                self._calls = event.calls
                self._rows = {name: _Row() for name in event.robots}
            case StepStarted(robot=str(who)):
                row = self._rows[who]
                row.state, row.label, row.since_s = "running", event.label, event.time_s
            case StepEnded(record=record) if record.robot is not None:
                row = self._rows[record.robot]
                row.state = "waiting" if record.outcome in ("done", "skipped", "stopped") else record.outcome
                row.since_s = None
                row.calls += record.is_call
            case RobotReplaced():
                self._rows[event.robot].state = "replaced"
            case RunPaused() | RunResumed():
                self._is_paused = isinstance(event, RunPaused) or event.is_single_step
            case RobotDropped():
                self._rows[event.robot].state = "dropped"
            case RunEnded(report=report):
                self._end_s = event.time_s
                for name, robot in report.robots.items():
                    self._rows[name].state, self._rows[name].since_s = robot.outcome, None

    def _picture(self) -> RenderableType:
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
        """Return the table of the robots, those at work first if not all fit, and a line about the others."""
        room = max(3, self._console.height - _LINES_AROUND)
        names = list(self._rows)
        if len(names) > room:
            names.sort(key=lambda name: self._rows[name].state != "running")  # stable: else in the fleet's order
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
