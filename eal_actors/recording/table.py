"""Write the robots' paths as a table."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import IO

from eal_actors.recording.pose_sample import PoseSample


class TrajectoryTable:
    """A table that grows while robots go, line by line, so that a crash loses nothing.

    A row holds robot, time_s to a thousandth, x_m, y_m and yaw_rad to a millionth.

    Args:
        path: the CSV file, made with the first row. One that is there is added to.

    Thread: one at a time.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._stream: IO[str] | None = None

    def add(self, robot: str, sample: PoseSample) -> None:
        """Add a row.

        Raises:
            OSError: it cannot be written.
        """
        if self._stream is None:
            self._stream = self._path.open("a", encoding="utf-8", newline="", buffering=1)  # by lines
            self._table = csv.writer(self._stream)
            if self._stream.tell() == 0:
                self._table.writerow(["robot", *PoseSample._fields])
        time_s, *pose = sample
        self._table.writerow([robot, f"{time_s:.3f}", *(f"{number:z.6f}" for number in pose)])

    def close(self) -> None:
        """Close the file.

        Raises:
            OSError: what was written last cannot be.
        """
        if self._stream is not None:
            self._stream.close()
