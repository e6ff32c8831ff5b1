"""Run a soak, print what it came to, and write it as JSON: `make soak`, which writes it into docs/soak.md too."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from tests.benchmarks.page import machine, write_between
from tests.soak.report import Report, tables
from tests.soak.run import Plan, Soak

BEGIN: Final = "<!-- written by make soak: begin -->"


def main() -> int:
    """Return 1 if anything is wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.soak", description=__doc__)
    parser.add_argument("--robots", type=int, default=Plan.robots)
    parser.add_argument("--minutes", type=float, default=Plan.duration_s / 60)
    parser.add_argument("--seed", type=int, default=Plan.seed)
    parser.add_argument("--json", type=Path, default=Path("runs/soak.json"), help="where to write the result")
    parser.add_argument("--folder", type=Path, help="where to keep everything that was written; else it is removed")
    parser.add_argument("--page", type=Path, help="a page of Markdown to write it into, between its marks")
    given = parser.parse_args()
    plan = Plan(given.robots, given.minutes * 60, given.seed)
    with tempfile.TemporaryDirectory(prefix="eal-soak-") as temporary:
        folder = given.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        report = Report.of(Soak(plan, folder.resolve()).run())
    sys.stdout.write("\n".join(report.lines()) + "\n")
    given.json.parent.mkdir(parents=True, exist_ok=True)
    given.json.write_text(json.dumps(report.to_dict(), indent=2) + "\n", encoding="utf-8")
    if given.page is not None:
        told = f"{tables(report.to_dict())}\n\n{datetime.now(UTC):%Y-%m-%d}, {machine()}."
        write_between(given.page, BEGIN, told)
    return 0 if report.holds else 1


if __name__ == "__main__":
    sys.exit(main())
