"""The screen of `eal top`: a table of robots, the newest run, and keys to stop all robots."""

from __future__ import annotations

import io
from collections import deque
from pathlib import Path
from typing import Any, ClassVar, Final

from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.screen import Screen
from textual.widgets import DataTable, Footer, Static
from typing_extensions import override

from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import Ping, RobotState
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import EALError
from eal_actors.operate.top.call_statistics import RecentCalls
from eal_actors.operate.top.robot_row import TableRow, robot_row
from eal_actors.operate.top.run_progress import RunProgress, latest_run

UPDATE_PERIOD_S: Final = 0.5
STOP_REASON: Final = "stopped at eal top"

_COLUMNS: Final = ("robot", "state", "mailbox", "oldest", "calls/s", "p50", "p99", "restarts", "running")
_STYLES: Final = {
    RobotState.READY.value: "green",
    RobotState.STARTING.value: "dim",
    RobotState.STOPPED.value: "dim",
    "STOP": "bold reverse red",
}


class LogBuffer(io.TextIOBase):
    """Keeps the last log lines, which would corrupt the screen if they were printed."""

    def __init__(self, most: int = 3) -> None:
        super().__init__()
        self.lines: deque[str] = deque(maxlen=most)

    @override
    def write(self, text: str) -> int:
        self.lines.extend(line for line in text.splitlines() if line.strip())
        return len(text)


class TopApp(App[None]):
    """Shows a connected fleet, and stops it.

    With `update_period_s` None, in real seconds, only `refresh_fleet` updates it.
    """

    TITLE = "eal top"
    CSS = """
    #head { height: 1; background: $panel; padding: 0 1; }
    DataTable { height: 1fr; }
    #run, #log { height: auto; max-height: 4; padding: 0 1; }
    #log { color: $text-muted; }
    Details { align: center middle; }
    Details VerticalScroll { width: 90%; height: 80%; border: round $primary; background: $surface; padding: 0 1; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("s", "stop_all", "STOP all", priority=True),
        Binding("r", "resume_all", "Resume"),
        Binding("enter,d", "details", "Details", priority=True),
        Binding("q", "quit", "Quit"),
        Binding("ctrl+c", "quit", show=False, priority=True),  # as it ends every other command
    ]
    ENABLE_COMMAND_PALETTE = False

    def __init__(
        self,
        fleet: Fleet,
        calls: RecentCalls,
        runs_dir: Path,
        log: LogBuffer | None = None,
        update_period_s: float | None = UPDATE_PERIOD_S,
    ) -> None:
        super().__init__()
        self.fleet = fleet
        self.rows: dict[str, TableRow] = {}
        self._calls, self._pings = calls, RecentCalls()
        self._runs_dir = runs_dir
        self._lines = log or LogBuffer()
        self._update_period_s = update_period_s
        self._answers: dict[str, Ping] = {}
        self._asked: dict[str, Future[Ping]] = {}
        self._orders: list[tuple[str, Future[Any]]] = []

    @override
    def compose(self) -> ComposeResult:
        yield Static(id="head")
        yield DataTable(cursor_type="row", zebra_stripes=True)
        yield Static(id="run")
        yield Static(id="log")
        yield Footer()

    def on_mount(self) -> None:
        """Fill the table, and start to update it."""
        table = self._table
        for column in _COLUMNS:
            table.add_column(column, key=column)
        for name in self.fleet:
            table.add_row(*("" for _ in _COLUMNS), key=name)
        table.focus()
        self.refresh_fleet()
        if self._update_period_s is not None:
            self.set_interval(self._update_period_s, self.refresh_fleet)

    @property
    def _table(self) -> DataTable[Text | str]:
        return self.screen_stack[0].query_one(DataTable)

    def refresh_fleet(self) -> None:
        """Show the current state of the fleet."""
        for name, robot in self.fleet.items():
            self._ping(robot)
            row = self.rows[name] = robot_row(robot, self._calls, self._pings, self._answers.get(name))
            for column, cell in zip(_COLUMNS, _cells(row), strict=True):
                self._table.update_cell(name, column, cell, update_width=True)
        base = self.screen_stack[0]
        ready = sum(row.state == RobotState.READY.value for row in self.rows.values())
        base.query_one("#head", Static).update(f"{self.fleet.name}: {ready} of {len(self.rows)} robots ready")
        base.query_one("#run", Static).update(_format_run(latest_run(self._runs_dir, self.fleet.name)))
        base.query_one("#log", Static).update(Text("\n".join(self._lines.lines)))
        self._report_orders()
        if isinstance(self.screen, Details):
            self.screen.show(self.fleet[self.screen.robot], self.rows[self.screen.robot])

    def _ping(self, robot: RobotHandle) -> None:
        """Ping a remote robot, unless its last answer is still open."""
        if not robot.is_remote or robot.state is not RobotState.READY:
            self._answers.pop(robot.name, None)
            return
        asked = self._asked.get(robot.name)
        if asked is not None and asked.done():
            if asked.exception() is None:
                self._answers[robot.name] = ping = asked.get()
                self._pings.add(robot.name, robot.clock.now(), robot.clock.of_real(ping.round_trip_s))
            asked = None
        if asked is None:
            self._asked[robot.name] = robot.ping()

    # Keys.

    def action_stop_all(self) -> None:
        """Stop every robot, from every screen."""
        self._order("stopped", self.fleet.stop(STOP_REASON))

    def action_resume_all(self) -> None:
        """End the emergency stop of every robot."""
        self._order("resumed", self.fleet.resume())

    def action_details(self) -> None:
        """Open the details of the robot under the cursor, or close them."""
        if isinstance(self.screen, Details):
            self.pop_screen()
        elif self.rows:
            self.push_screen(Details(list(self.fleet)[self._table.cursor_row]), callback=None)
            self.call_after_refresh(self.refresh_fleet)

    def _order(self, what: str, future: Future[Any]) -> None:
        self._orders.append((what, future))

        def refresh(_: Future[Any]) -> None:  # in the thread that resolves the future
            self.call_later(self.refresh_fleet)

        future.add_done_callback(refresh)

    def _report_orders(self) -> None:
        for what, future in [order for order in self._orders if order[1].done()]:
            self._orders.remove((what, future))
            if (error := future.exception()) is None:
                self.notify(f"all robots {what}")
            else:
                shown = str(error) if isinstance(error, EALError) else repr(error)
                self.notify(f"not all robots {what}: {shown}", severity="error", timeout=30)


class Details(Screen[None]):
    """All details of one robot."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape", "app.pop_screen", "Back")]

    def __init__(self, robot: str) -> None:
        super().__init__()
        self.robot = robot

    @override
    def compose(self) -> ComposeResult:
        with VerticalScroll():
            yield Static(id="details")
        yield Footer()

    def show(self, robot: RobotHandle, row: TableRow) -> None:
        """Show the robot's current state."""
        self.query_one("#details", Static).update(Text("\n".join(_details(robot, row))))


def _cells(row: TableRow) -> list[Text | str]:
    running = "; ".join(
        f"{run.resource} {run.command} {_percent(run.progress.fraction if run.progress else None)}".rstrip()
        for run in row.running
    )
    waits = row.waiting is not None and row.waiting > 0
    return [
        Text(row.name, style="cyan"),
        Text(row.state, style=_STYLES.get(row.state, "bold red")),
        "–" if row.waiting is None else str(row.waiting),
        _format_s(row.oldest_s) if waits else "–",
        f"{row.statistics.calls_per_s:.1f}",
        _format_s(row.statistics.p50_s),
        _format_s(row.statistics.p99_s),
        Text("–" if row.restarts is None else str(row.restarts), style="yellow" if row.restarts else ""),
        Text(running) if running else Text(row.notes[0] if row.notes else "", style="yellow"),
    ]


def _details(robot: RobotHandle, row: TableRow) -> list[str]:
    kind = f" ({robot.type})" if robot.type else ""
    lines = [f"{row.name}{kind}: {row.state}, {'in another process' if row.is_remote else 'in this process'}", ""]
    restarts = robot.restarts
    for name, handle in robot.items():
        waiting = handle.waiting
        mailbox = "" if waiting is None else f", {waiting.count} calls waiting for up to {_format_s(waiting.oldest_s)}"
        again = f", restarted {restarts[name]} times" if restarts.get(name) else ""
        lines.append(f"  {name}{mailbox}{again}")
    for run in row.running:
        progress = f" {_percent(run.progress.fraction)} {run.progress.text}".rstrip() if run.progress else ""
        since_s = max(0.0, robot.clock.now() - run.since_s)
        lines.append(f"  running {run.resource} {run.command}{progress}, for {since_s:.1f} s, by {run.by}")
    return [*lines, "", *(f"! {note}" for note in row.notes)]


def _format_run(run: RunProgress | None) -> Text:
    if run is None:
        return Text("no record of a run of this fleet", style="dim")
    failed = f", {run.failed} steps failed" if run.failed else ""
    calls = f"{run.done}/{max(run.done, run.calls)} calls{failed}"
    if run.outcome is not None:
        return Text(f"last run: {run.scenario} {run.outcome}, {calls}", style="dim")
    steps = "; ".join(f"{robot or 'run'}: {label}" for robot, label in sorted(run.steps.items()))
    return Text(f"{run.scenario}: {calls}  {steps}")


def _percent(fraction: float | None) -> str:
    return "" if fraction is None else f"{fraction:.0%}"


def _format_s(seconds: float | None) -> str:
    if seconds is None:
        return "–"
    return f"{seconds * 1000:.1f} ms" if seconds < 1 else f"{seconds:.1f} s"
