"""Record where robots are while they work, for any robot with a Pose."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable
from operator import attrgetter
from types import TracebackType
from typing import Final, Self

from eal_actors.actors.handles import ResourceHandle
from eal_actors.device.data import DataType, EALData, ValueInfo
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.log import get_logger
from eal_actors.recording.pose_sample import PoseSample
from eal_actors.recording.sampler import Sampler, Wish

POSE_RESOURCE: Final = "Pose"
"""The resource that is asked: its value is [x m, y m, yaw rad] in the world frame."""
POSE_PERIOD_S: Final = 0.1
_POSE: Final = ValueInfo(DataType.DOUBLE, shape=(3,))


def pose_sample(robot: str, data: EALData, clock: Clock) -> PoseSample | None:
    """Return what a robot's Pose said, in seconds of the fleet's clock; None, which is logged, if it is no pose."""
    problem = _POSE.problem(data)
    if problem is None and not all(map(math.isfinite, data.value)):
        problem = f"must be finite, not {data!r}"
    if problem is not None:
        get_logger(robot=robot).warning("its path is recorded no more", reason=f"the value of its Pose {problem}")
        return None
    return PoseSample(data.stamp_s if data.stamp_s is not None else clock.now(), *map(float, data.value))


class Paths:
    """The poses of robots, as they come. Thread: one adds; others read when it is over.

    Args:
        robots: the names of those with a Pose.
        clock: the fleet's clock, for poses without a stamp.
    """

    def __init__(self, robots: Iterable[str], clock: Clock) -> None:
        self._paths: dict[str, list[PoseSample]] = {name: [] for name in robots}
        self._clock = clock

    def add(self, robot: str, data: EALData) -> bool:
        """Add a pose unless it is no newer than the last; returns False, and logs why, if it is no pose."""
        sample = pose_sample(robot, data, self._clock)
        if sample is None:
            return False
        path = self._paths[robot]
        if not path or path[-1].time_s < sample.time_s:
            path.append(sample)
        return True

    def since(self, start_s: float) -> dict[str, list[PoseSample]]:
        """Return the samples by robot, in the order of time, with times that count from a run's start.

        Of the samples before the start each path keeps the last one, as of time 0.

        Args:
            start_s: the start, in seconds of the fleet's clock.
        """
        paths = {}
        for name, path in self._paths.items():
            first = max(bisect_right(path, start_s, key=attrgetter("time_s")) - 1, 0)
            paths[name] = [sample._replace(time_s=max(sample.time_s - start_s, 0.0)) for sample in path[first:]]
        return paths


class PoseRecorder:
    """Asks every robot for its pose, period after period, between `with` and its end.

    A robot that does not answer within the period is passed over until it has. One whose Pose is no pose is asked no
    more.

    Args:
        fleet: a connected fleet.
        robots: the names of the robots; those without a Pose are left out.
        period_s: seconds of the fleet's clock between two samples.
    """

    def __init__(self, fleet: Fleet, robots: Iterable[str], period_s: float = POSE_PERIOD_S) -> None:
        poses = [fleet[name][POSE_RESOURCE] for name in robots if POSE_RESOURCE in fleet[name]]
        self._paths = Paths((pose.robot for pose in poses), fleet.clock)
        self._sampler = Sampler(fleet.clock, [Wish(pose, period_s) for pose in poses], self._take)

    def __enter__(self) -> Self:
        self._sampler.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._sampler.__exit__(kind, error, traceback)

    def _take(self, pose: ResourceHandle, data: EALData) -> bool:
        return self._paths.add(pose.robot, data)

    def paths_since(self, start_s: float) -> dict[str, list[PoseSample]]:
        """Return the samples by robot; see Paths.since."""
        return self._paths.since(start_s)
