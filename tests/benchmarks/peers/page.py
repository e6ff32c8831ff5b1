"""The page and the chart that the benchmark writes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from tests.benchmarks.page import machine

REFERENCE: Final = "raw TCP"
OURS: Final = "eal-actors"
WHAT: Final[Mapping[str, str]] = {
    "get": "reading of 24 bytes, p50",
    "command": "command until its answer, p50",
    "callers": "reading with 8 callers at once, each",
    "frame": "reading of 921,600 bytes, p50",
    "fan_out": "one command to 100 robots, all answers",
    "reconnect": "first answer after a kill and restart",
}
RECONNECTS: Final = 5
"""Rounds of the restart, which takes longest."""
_TEXT: Final = """\
# Comparison with peers

`make bench-peers` writes this page. It runs the same work through this project, the engines below it and other
projects, in turn in one run, with all processes on one core. Each figure is the median over {rounds} rounds,
that of the restart over {restarts}. The number in brackets is the ratio to raw TCP, the median of the rounds' ratios.
Smaller is better.

{table}

![Duration relative to raw TCP on a logarithmic axis](images/peers.svg)

{absent}The guarantees differ. Raw TCP sends one byte and receives bytes. Bare Pykka stays within one process.
Pyro5, xoscar and viam-sdk carry a call and its answer; viam-sdk uses gRPC with its own components (sensor readings, a
command, camera images), served by its own Python server and called directly. Only eal-actors checks each command for
staleness and repetition, grants an actuator to one controller at a time, halts robots whose controller falls silent,
and ends every call at its deadline.

- Bare zenoh uses its queries. In the column "floor", a call and its answer are one publication each, as in eal-actors,
  with declared publishers, channels and a caller that reads the channel itself: the least that a call through the
  engine takes. [The account of a call](network-account.md) tells what eal-actors adds.
- All run on one machine. There, calls of eal-actors take a local link past the engine, which robots elsewhere do not
  have: [its account](network-account.md) has both.
- One of the hundred robots is a connection with raw TCP, Pyro5 and viam-sdk, and a name behind one connection with the
  others.
- After the kill, the time starts when the new process listens. Raw TCP, Pyro5, xoscar and viam-sdk are retried every
  2 ms with a new connection. zenoh and eal-actors find the robot by themselves: zenoh with
  back-off between attempts, eal-actors at a constant rate.

{date}, {machine}; {versions}.
"""


@dataclass(frozen=True)
class Figure:
    """The duration of one operation with one peer.

    Attributes:
        seconds: the median over the rounds.
        ratio: to raw TCP in the same round, the median over the rounds.
    """

    seconds: float
    ratio: float

    def __str__(self) -> str:
        ratio = f"{self.ratio:.1f}" if self.ratio < 10 else f"{self.ratio:.0f}"
        return f"{_shown(self.seconds)} ({ratio}x)"


Figures = Mapping[str, Mapping[str, Figure]]
"""By the names of the peers, in their order, then by what was measured."""


def _shown(seconds: float) -> str:
    scale, unit = (1e6, "µs") if seconds < 1e-3 else (1e3, "ms") if seconds < 1 else (1.0, "s")
    value = seconds * scale
    return f"{value:.0f} {unit}" if value >= 100 else f"{value:.1f} {unit}"


def rows(figures: Figures) -> list[list[str]]:
    """Return the table with its head."""
    body = [[what, *(str(of[key]) if key in of else "" for of in figures.values())] for key, what in WHAT.items()]
    return [["", *figures], *body]


def page(figures: Figures, titles: Sequence[str], absent: Mapping[str, str], rounds: int) -> str:
    """Return the page."""
    head, *body = rows(figures)
    lines = [head, ["---"] * len(head), *body]
    return _TEXT.format(
        rounds=rounds,
        restarts=RECONNECTS,
        table="\n".join(f"| {' | '.join(line)} |" for line in lines),
        absent="".join(f"Left out: {name}, for {reason}.\n\n" for name, reason in absent.items()),
        date=f"{datetime.now(UTC):%Y-%m-%d}",
        machine=machine(),
        versions=", ".join(titles),
    )


def draw(figures: Figures, path: Path) -> None:
    """Draw the ratios, a panel for each thing, ours in colour."""
    import matplotlib as mpl
    from matplotlib.figure import Figure as Picture

    with mpl.rc_context({"svg.hashsalt": "peers", "svg.fonttype": "none", "font.size": 9}):
        picture = Picture(figsize=(10, 5.6), layout="constrained")
        most = max(figure.ratio for of in figures.values() for figure in of.values())
        for place, (key, what) in enumerate(WHAT.items(), 1):
            panel = picture.add_subplot(2, 3, place)
            known = [(name, of[key].ratio) for name, of in figures.items() if key in of and name != REFERENCE]
            known.sort(key=lambda entry: -entry[1])
            names, ratios = zip(*known, strict=True)
            bars = panel.barh(names, ratios, color=["#c8553d" if name == OURS else "#9fb1bd" for name in names])
            panel.bar_label(bars, [f"{ratio:.1f}" if ratio < 10 else f"{ratio:.0f}" for ratio in ratios], padding=2)
            panel.set_xscale("log")
            panel.set_xlim(0.4, most * 4)
            panel.axvline(1.0, color="#444444", linewidth=0.8)
            panel.set_title(what, fontsize=9, loc="left")
            panel.spines[["top", "right"]].set_visible(False)
        picture.supxlabel("times as long as raw TCP (logarithmic)", fontsize=9)
        path.parent.mkdir(parents=True, exist_ok=True)
        picture.savefig(path, format="svg", metadata={"Date": None})
