"""The occupancy grid of a run: every recorded scan at the pose that its robot estimated then."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eal_actors.device.navigation.grid import OccupancyGrid
from eal_actors.device.navigation.scan_map import ScanMap
from eal_actors.kernel.errors import ArgumentError, ScenarioError
from eal_actors.recording import schemas
from eal_actors.recording.mcap_file import RECORD_FILE, RecordedMessage, read_mcap
from eal_actors.recording.messages import FARTHEST_M, ranges_of, yaw_of
from eal_actors.recording.run_folder import RunFolder

_Poses = NDArray[np.float64]
"""Time in s, x and y in m and unwrapped yaw in rad, shape (n, 4), in the order of time."""
_ESTIMATE: Final = "Pose"
_FAR_M: Final = 100.0
"""Greatest range of a scanner that reports none."""


def map_of_run(run: Path, resolution_m: float) -> OccupancyGrid:
    """Return the map of all scans of a run; `resolution_m` is the length of a cell's side.

    The pose of a scan is interpolated between the recorded estimates before and after it; scans without either are
    left out. The greatest range of a scanner is the greatest that it reported: such rays met nothing.

    Raises:
        ScenarioError: it is no folder of a run, or has no record, no scan with a pose, or scans over too large an area.
        UnsupportedError: the mcap library is not installed.
        OSError: the record cannot be read.
    """
    file = RunFolder.open(run).path / RECORD_FILE
    if not file.is_file():
        raise ScenarioError(f"{run} has no {RECORD_FILE}; `eal run` writes it if the extra `record` is installed")
    messages = sorted(read_mcap(file).messages, key=attrgetter("topic", "time_s"))
    topics = {topic: list(entries) for topic, entries in groupby(messages, attrgetter("topic"))}
    scanners = {topic: scans for topic, entries in topics.items() if (scans := list(filter(_is_scan, entries)))}
    try:
        found = ScanMap(resolution_m)
        for topic, scans in scanners.items():
            poses = _poses(topics.get(f"/{topic.split('/')[1]}/{_ESTIMATE}", ()))
            _add(found, scans, poses, _reach(scans))
        return found.grid()
    except ArgumentError as error:
        seen = ", ".join(scanners) or "no scanner; record one, such as a `Lidar`, with `eal run --record sensors`"
        raise ScenarioError(f"{run} gives no map: {error.message}; recorded: {seen}") from error


def _is_scan(entry: RecordedMessage) -> bool:
    return entry.schema == schemas.SCAN.name


def _poses(entries: Iterable[RecordedMessage]) -> _Poses:
    rows = []
    for entry in entries:
        at, turn = entry.message["pose"]["position"], entry.message["pose"]["orientation"]
        rows.append((entry.time_s, at["x"], at["y"], yaw_of(turn)))
    poses = np.array(rows, np.float64).reshape(-1, 4)
    poses[:, 3] = np.unwrap(poses[:, 3])
    return poses


def _reach(scans: Iterable[RecordedMessage]) -> float:
    """Return the greatest finite range of a scanner."""
    ranges = np.array([range_m for scan in scans for range_m in scan.message["ranges"]])
    return float(ranges[ranges < FARTHEST_M].max(initial=0.0)) or _FAR_M


def _add(found: ScanMap, scans: Iterable[RecordedMessage], poses: _Poses, reach_m: float) -> None:
    if not len(poses):
        return
    for scan in scans:
        if poses[0, 0] <= scan.time_s <= poses[-1, 0]:
            x_m, y_m, yaw_rad = (float(np.interp(scan.time_s, poses[:, 0], column)) for column in poses.T[1:])
            ranges = np.array(ranges_of(scan.message))
            angles = np.linspace(scan.message["start_angle"], scan.message["end_angle"], len(ranges))
            found.add((x_m, y_m, yaw_rad), ranges, angles, reach_m)
