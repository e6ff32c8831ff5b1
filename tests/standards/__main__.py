"""Drive the squares of scenarios/standards.yaml while one robot fails, and print what became of each robot."""

from __future__ import annotations

import argparse
import math
import os
import shutil
import sys
from pathlib import Path

from tests.standards.drive import Drive, drive

KINDS = {
    "turtle-1": "ROS 2, zenoh-ros2-sdk",
    "agv-1": "VDA 5050, vda5050-sdk at mosquitto",
    "rover-1": "MAVLink, pymavlink",
    "roomba-1": "serial, emulated Roomba",
}


def main() -> int:
    """Return 0 if one robot failed and all others are back where they began."""
    parser = argparse.ArgumentParser(prog="python -m tests.standards", description=__doc__)
    parser.add_argument("--failing", choices=sorted(KINDS), default="rover-1")
    parser.add_argument("--side-m", type=float, default=0.6, help="length of a side")
    given = parser.parse_args()
    if shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin") is None:
        parser.error("mosquitto is not installed: apt install mosquitto")
    return show(drive(Path("runs").resolve(), given.failing, given.side_m), given.failing)


def show(driven: Drive, failing: str) -> int:
    """Print the outcome of each robot; return the exit code."""
    report = driven.run.summary
    if report is None:
        sys.stdout.write("the run has no summary\n")
        return 1
    for robot, kind in KINDS.items():
        off_m = math.dist(driven.starts[robot], driven.ends[robot])
        outcome = report.robots[robot].outcome
        poses = f"{len(driven.run.paths[robot])} poses recorded, {len(driven.shown.get(robot, ()))} in Foxglove's view"
        sys.stdout.write(f"{robot:9} {outcome:8} truly {off_m:.2f} m from its start; {poses} ({kind})\n")
    return 0 if driven.exit_code == 0 and list(report.dropped) == [failing] else 1


if __name__ == "__main__":
    sys.exit(main())
