"""Poses of robots while they work: samples, the recorder that collects them, and `trajectory.csv`."""

from __future__ import annotations

import csv
import math
from bisect import bisect_left, bisect_right
from collections.abc import Container, Iterable, Sequence
from contextlib import ExitStack
from operator import attrgetter
from pathlib import Path
from typing import IO, Final, NamedTuple, Self

from eal_actors.actors.handles import ResourceHandle
from eal_actors.device.data import DataType, EALData
from eal_actors.device.info import ValueInfo
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.log import get_logger
from eal_actors.recording.sampler import Sampler, SampleSpec

POSE_RESOURCES: Final = ("TruePose", "Pose")
"""The sampled resources; their values are [x m, y m, yaw rad] in the map frame. A path is of the first that exists."""
POSE_PERIOD_S: Final = 0.1
_POSE: Final = ValueInfo(DataType.DOUBLE, shape=(3,))
ROUNDING_S: Final = 0.0005
"""Times in tables are rounded to a thousandth of a second."""


class PoseSample(NamedTuple):
    """A pose in the map frame and its time in seconds, of the fleet's clock or since a run's start."""

    time_s: float
    x_m: float
    y_m: float
    yaw_rad: float


def path_resource(resources: Container[str]) -> str | None:
    """Return the name of the resource whose values are the robot's path; None if it has none."""
    return next((name for name in POSE_RESOURCES if name in resources), None)


def pose_sample(pose: ResourceHandle, data: EALData, clock: Clock) -> PoseSample | None:
    """Return the value of a pose resource as a sample of the fleet's clock; log and return None if it is no pose."""
    problem = _POSE.problem(data)
    if problem is None and not all(map(math.isfinite, data.value)):
        problem = f"must be finite, not {data!r}"
    if problem is not None:
        reason = f"the value of its {pose.name} {problem}"
        get_logger(robot=pose.robot).warning("the path is no longer recorded", reason=reason)
        return None
    return PoseSample(data.stamp_s if data.stamp_s is not None else clock.now(), *map(float, data.value))


def index_at(path: Sequence[PoseSample], time_s: float) -> int:
    """Return the index of the last sample of a path until a time; 0 if there is none."""
    return max(bisect_right(path, time_s, key=attrgetter("time_s")) - 1, 0)


def split_at_breaks(path: Sequence[PoseSample], breaks_s: Sequence[float]) -> list[Sequence[PoseSample]]:
    """Split a path at the times at which its run was resumed: nothing is known between two parts."""
    parts, first = [], 0
    for break_s in breaks_s:
        last = bisect_left(path, break_s - ROUNDING_S, key=attrgetter("time_s"))
        parts.append(path[first:last])
        first = last
    return [part for part in (*parts, path[first:]) if part]


class PoseRecorder(ExitStack):
    """Samples the pose of every robot, ten times a second of the fleet's clock, inside its `with` block.

    The pose is the true one where there is one, in simulation, else the estimate. A robot that does not answer within
    the period is skipped until it has answered. A robot whose Pose is no pose is not sampled again. Robots without a
    Pose are ignored.
    """

    def __init__(self, fleet: Fleet, robots: Iterable[str]) -> None:
        super().__init__()
        poses = [fleet[name][pose] for name in robots if (pose := path_resource(fleet[name])) is not None]
        self._clock = fleet.clock
        self._paths: dict[str, list[PoseSample]] = {pose.robot: [] for pose in poses}
        self._sampler = Sampler(fleet.clock, [SampleSpec(pose, POSE_PERIOD_S) for pose in poses], self._add)

    def __enter__(self) -> Self:
        self.enter_context(self._sampler)
        return self

    def _add(self, pose: ResourceHandle, data: EALData) -> bool:
        sample = pose_sample(pose, data, self._clock)
        if sample is None:
            return False
        path = self._paths[pose.robot]
        if not path or path[-1].time_s < sample.time_s:
            path.append(sample)
        return True

    def paths_since(self, start_s: float) -> dict[str, list[PoseSample]]:
        """Return the samples by robot, in the order of time, with times since a run's start by the fleet's clock.

        Each path begins with the last sample before the start, as of time 0.
        """
        paths = {}
        for name, path in self._paths.items():
            samples = path[index_at(path, start_s) :]
            paths[name] = [sample._replace(time_s=max(sample.time_s - start_s, 0.0)) for sample in samples]
        return paths


class TrajectoryTable:
    """The CSV file of the robots' paths, written line by line so that a crash loses nothing.

    A row has robot, time_s to a thousandth, and x_m, y_m and yaw_rad to a millionth. Rows are appended if the file
    exists.

    Thread: one at a time.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._stream: IO[str] | None = None

    def add(self, robot: str, sample: PoseSample) -> None:
        """Append a row; raise OSError if it cannot be written."""
        if self._stream is None:
            self._stream = self._path.open("a", encoding="utf-8", newline="", buffering=1)  # by lines
            self._table = csv.writer(self._stream)
            if self._stream.tell() == 0:
                self._table.writerow(["robot", *PoseSample._fields])
        time_s, *pose = sample
        self._table.writerow([robot, f"{time_s:.3f}", *(f"{number:z.6f}" for number in pose)])

    def close(self) -> None:
        """Close the file; raise OSError if the last rows cannot be written."""
        if self._stream is not None:
            self._stream.close()
