"""Progress of long work: how much is done, how fast it goes, how long the rest takes, and a summary."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column
from rich.text import Text
from typing_extensions import override

from eal_actors.cli.output import counted, print_line
from eal_actors.kernel.clock import REAL_TIME


class OnDone(Protocol):
    """Called for each finished part."""

    def __call__(self, line: str | Text, is_important: bool, total: int | None = None) -> None:
        """Note a finished part; an important line is shown on a terminal too. `total` may tell the number of parts."""


class _RateColumn(ProgressColumn):
    """Parts in a second, or in a minute where they are slow."""

    def __init__(self) -> None:
        super().__init__(Column(no_wrap=True))

    @override
    def render(self, task: Task) -> Text:
        return Text(_rate(task.speed) if task.speed else "", style="dim")


@contextmanager
def work_progress(console: Console, noun: str, total: int | None, finished: int = 0, of: str = "") -> Iterator[OnDone]:
    """Show a bar on a terminal, or a line for each part elsewhere; at the end, or at Ctrl-C, a summary.

    `noun` names a part, such as `run`, and `of` says whose parts they are. `finished` parts were done before. `total`
    is None where the first part tells it.
    """
    start_s, done, count = REAL_TIME.now(), 0, total

    def advance(line: str | Text, is_important: bool, total: int | None = None) -> None:
        nonlocal done, count
        done, count = done + 1, total or count
        if bar is None:
            print_line(console, Text(f"{finished + done}/{count}  ").append_text(Text() + line))
            return
        bar.update(task, advance=1, total=count)
        if is_important:
            print_line(bar.console, line)

    bar = _bar(console) if console.is_terminal else None
    if bar is not None:
        bar.start()
        task = bar.add_task(f"{noun}s{of}", total=total, completed=finished)
    try:
        yield advance
    finally:
        if bar is not None:
            bar.stop()
        if done > 1:
            duration_s = REAL_TIME.now() - start_s
            what = counted(done, noun) if finished + done == count else f"{done} of {count} {noun}s"
            print_line(console, f"{what}{of} in {_duration(duration_s)}, {_rate(done / max(duration_s, 1e-9))}", "dim")


def _bar(console: Console) -> Progress:
    columns = (BarColumn(), MofNCompleteColumn(), _RateColumn(), TimeElapsedColumn(), TextColumn("left:"))
    return Progress(TextColumn("{task.description}"), *columns, TimeRemainingColumn(), console=console, transient=True)


def _rate(per_s: float) -> str:
    return f"{per_s:.1f} per second" if per_s >= 1 else f"{per_s * 60:.1f} per minute"


def _duration(duration_s: float) -> str:
    minutes, seconds = divmod(round(duration_s), 60)
    return f"{minutes} min {seconds} s" if minutes else f"{duration_s:.1f} s"
