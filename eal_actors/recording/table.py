"""Write the robots' paths as a table."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

from eal_actors.record.pose_sample import PoseSample


def write_trajectory(paths: Mapping[str, Sequence[PoseSample]], out: Path) -> None:
    """Write the samples, robot after robot: robot, time_s to a thousandth, x_m, y_m and yaw_rad to a millionth.

    Args:
        paths: samples by robot.
        out: the CSV file to write.

    Raises:
        OSError: it cannot be written.
    """
    with out.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(["robot", *PoseSample._fields])
        for name, path in paths.items():
            for time_s, *pose in path:
                table.writerow([name, f"{time_s:.3f}", *(f"{number:z.6f}" for number in pose)])
