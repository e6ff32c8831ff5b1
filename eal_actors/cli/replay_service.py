"""Serves the robots of a recorded run on this machine, and shows the position of the playback."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from eal_actors.cli.interrupts import handle_signals
from eal_actors.cli.output import print_line, service_output
from eal_actors.facade.service import serve_together
from eal_actors.kernel.clock import REAL_TIME, Clock, new_waiter
from eal_actors.managers.fleet_model import FleetConfig

_REDRAW_S = 0.25


def serve_replay(config: FleetConfig, robots: Sequence[str], duration_s: float, *, loops: bool) -> None:
    """Serve the robots of a replay until Ctrl-C; all of them share one playback."""
    handle_signals()
    out = service_output()
    with serve_together(config, robots) as services:
        clock = services[0].robot.clock
        playback = _Playback(clock, duration_s, loops=loops)
        try:
            for service in services:
                print_line(out, f"{service.robot.name}: {', '.join(service.endpoints)}")
            playback.show(out)
            print_line(out, f"the record ended at {duration_s:.1f} s; the robots are served until Ctrl-C", "dim")
            REAL_TIME.wait(new_waiter(), None)
        except KeyboardInterrupt:
            print_line(out, f"{playback.summary()}; leaving the network")


class _Playback:
    """The position of a playback that starts now."""

    def __init__(self, clock: Clock, duration_s: float, *, loops: bool) -> None:
        self._clock = clock
        self._duration_s = duration_s
        self._loops = loops
        self._start_s = clock.now()
        self._start_real_s = REAL_TIME.now()

    def show(self, console: Console) -> None:
        """Show the position, the rate and the rest until the end; a loop has none."""
        waiter = new_waiter()
        rate = f"at rate {self._clock.of_real(1.0):g}"
        texts = (TextColumn("{task.fields[position]}"), TextColumn(rate), TextColumn("left:"))
        columns = (TextColumn("replay"), BarColumn(), *texts, TimeRemainingColumn())
        with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
            task = bar.add_task("", total=self._duration_s, position="")
            while (gone_s := self._gone_s()) < self._duration_s or (self._loops and self._duration_s):
                time_s, rounds = gone_s % self._duration_s if self._loops else gone_s, int(gone_s // self._duration_s)
                again = f", round {rounds + 1}" if self._loops else ""
                bar.update(task, completed=time_s, position=f"{time_s:.1f}/{self._duration_s:.1f} s{again}")
                rest_s = self._duration_s - time_s
                self._clock.wait(waiter, min(rest_s, self._clock.of_real(_REDRAW_S)) if console.is_terminal else rest_s)

    def summary(self) -> str:
        gone_s, took_s = self._gone_s(), REAL_TIME.now() - self._start_real_s
        what = f"{gone_s:.1f} s" if self._loops else f"{min(gone_s, self._duration_s):.1f} of {self._duration_s:.1f} s"
        return f"replayed {what}, served for {took_s:.1f} s"

    def _gone_s(self) -> float:
        return self._clock.now() - self._start_s
