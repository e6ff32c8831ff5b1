"""The cost of robots with three resources, for 10, 100 and 1,000 robots: at their host and at a remote controller.

Run as `python -m tests.benchmarks.scale`: it writes its figures into docs/scaling.md, between the two marks there.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from tests.benchmarks.page import machine, write_between
from tests.net.links import free_port

ROOT: Final = Path(__file__).parents[2]
PAGE: Final = ROOT / "docs" / "scaling.md"
BEGIN: Final = "<!-- written by make bench-scale: begin -->"
SIZES: Final = (10, 100, 1000)
FLAT: Final = 0.25
"""By how much the cost of a robot may differ between the smallest and the largest fleet, to count as flat."""

_Taken = Mapping[str, float]


@dataclass(frozen=True)
class Row:
    """A line of the table.

    Attributes:
        what: what it is.
        key: the name of the measurement.
        scale: from its unit to that of the table.
        unit: of the table, for each robot.
    """

    what: str
    key: str
    scale: float
    unit: str


ROWS: Final = (
    Row("start-up", "start_s", 1e3, "ms"),
    Row("memory", "memory_bytes", 1e-3, "kB"),
    Row("threads", "threads", 1, ""),
    Row("a command to each robot, answers gathered", "command_s", 1e6, "µs"),
    Row("processor time of that, in this process", "command_work_s", 1e6, "µs"),
    Row("the same by bare Pykka, among as many threads", "bare_s", 1e6, "µs"),
    Row("a reading from each robot, gathered", "read_s", 1e6, "µs"),
    Row("a call to each of three resources, gathered", "all_s", 1e6, "µs"),
)


def measure(robots: int) -> tuple[_Taken, _Taken]:
    """Return what the host and what the controller measured."""
    port = free_port()
    arguments = [sys.executable, "-m", "tests.benchmarks.scale_host"]
    host = subprocess.Popen(
        [*arguments, "host", str(robots), str(port)],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        assert host.stdout is not None
        hosted = json.loads(host.stdout.readline())
        if host.stdout.readline() != "up\n":
            raise AssertionError("the host did not come up")
        control = [*arguments, "control", str(robots), str(port)]
        done = subprocess.run(control, cwd=ROOT, capture_output=True, text=True, timeout=600, check=True)
        return hosted, json.loads(done.stdout)
    finally:
        host.kill()
        host.communicate()


def table(taken: Sequence[_Taken]) -> str:
    """Return the table of what one robot costs, at each size."""
    head = ["for each robot", *(f"of {size:,}" for size in SIZES), f"{SIZES[-1]:,} against {SIZES[1]:,}", "all of them"]
    lines = [head, ["---"] * len(head)]
    for row in ROWS:
        if row.key not in taken[0]:
            continue
        each = [of[row.key] * row.scale / size for of, size in zip(taken, SIZES, strict=True)]
        change = each[-1] / each[1] - 1
        verdict = f"{change:+.0%}" + (", see below" if change > FLAT else "")
        lines.append([row.what, *(_shown(value, row.unit) for value in each), verdict, _whole(row, taken[-1][row.key])])
    refused = [f"{of['refused']:.1%}" for of in taken]
    lines.append(["calls refused, as they had become stale", *refused, "", ""])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _shown(value: float, unit: str) -> str:
    return f"{value:.1f} {unit}".strip() if value < 10 else f"{value:.0f} {unit}".strip()


def _whole(row: Row, value: float) -> str:
    if row.key == "memory_bytes":
        return f"{value / 1e6:.0f} MB"
    return f"{value:,.0f}" if row.key == "threads" else f"{value:.2f} s" if value >= 1 else f"{value * 1e3:.0f} ms"


def main() -> int:
    """Measure, print, and write into the page."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.scale", description=__doc__)
    parser.add_argument("--page", type=Path, default=PAGE)
    given = parser.parse_args()
    hosted, controlled = zip(*map(measure, SIZES), strict=True)
    written = "\n\n".join(
        [
            "Robots of three resources in one process, called from that process:",
            table(hosted),
            "The same robots, served by that process and called through the network by another one:",
            table(controlled),
            f"{datetime.now(UTC):%Y-%m-%d}, {machine()}.",
        ]
    )
    sys.stdout.write(written + "\n")
    write_between(given.page, BEGIN, written)
    return 0


if __name__ == "__main__":
    sys.exit(main())
