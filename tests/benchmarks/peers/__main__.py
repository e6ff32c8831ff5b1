"""Measure all peers that are installed, print the table, and write docs/peers.md with its chart."""

from __future__ import annotations

import argparse
import os
import statistics
import sys
from collections import defaultdict
from contextlib import ExitStack
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.table import Table

from tests.benchmarks.peers.engine import ENGINES
from tests.benchmarks.peers.others import Pyro, Viam, Xoscar
from tests.benchmarks.peers.ours import Ours
from tests.benchmarks.peers.page import RECONNECTS, REFERENCE, WHAT, Figure, draw, page, rows
from tests.benchmarks.peers.peer import ROOT, Absent, Peer
from tests.benchmarks.peers.tcp import Tcp

PEERS: Final[tuple[type[Peer], ...]] = (Tcp, *ENGINES, Ours, Pyro, Xoscar, Viam)
COUNTS: Final = {"get": 60, "command": 60, "callers": 15, "frame": 5, "fan_out": 3, "reconnect": 1}
PAGE: Final = ROOT / "docs" / "peers.md"
CHART: Final = ROOT / "docs" / "images" / "peers.svg"


def measure(peers: list[Peer], rounds: int, console: Console) -> dict[str, dict[str, Figure]]:
    """Measure everything in turn, and return the medians."""
    seconds: dict[str, dict[str, list[float]]] = {peer.name: defaultdict(list) for peer in peers}
    for what in WHAT:
        with console.status(f"measuring: {WHAT[what]}"):
            for _ in range(RECONNECTS if what == "reconnect" else rounds):
                for peer in peers:
                    if what in peer.measures:
                        seconds[peer.name][what].append(getattr(peer, what)(COUNTS[what]))
    reference = seconds[REFERENCE]
    return {
        name: {
            what: Figure(
                statistics.median(times),
                statistics.median(mine / theirs for mine, theirs in zip(times, reference[what], strict=True)),
            )
            for what, times in of.items()
        }
        for name, of in seconds.items()
    }


def main() -> int:
    """Return 0; there are no limits to keep here."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.peers", description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--page", type=Path, default=PAGE)
    parser.add_argument("--chart", type=Path, default=CHART)
    given = parser.parse_args()
    console = Console()
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # the servers' processes inherit it
    absent: dict[str, str] = {}
    with ExitStack() as stack:
        peers: list[Peer] = []
        for kind in PEERS:
            try:
                peers.append(kind())
            except Absent as reason:
                absent[kind.name] = str(reason)
                console.print(f"left out: {kind.name}: {reason}")
            else:
                stack.callback(peers[-1].close)
        titles = [peer.title for peer in peers if peer.package is not None]
        figures = measure(peers, given.rounds, console)
    head, *body = rows(figures)
    table = Table(*head)
    for row in body:
        table.add_row(*row)
    console.print(table)
    draw(figures, given.chart)
    given.page.write_text(page(figures, titles, absent, given.rounds), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
