"""Record where robots are while they work, through the resource API, so that it works for any robot with a Pose."""

from __future__ import annotations

import math
import threading
from bisect import bisect_right
from collections.abc import Iterable, Mapping
from operator import attrgetter
from types import TracebackType
from typing import Final, NamedTuple, Self

from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle
from eal_actors.clock import new_waiter
from eal_actors.data import DataType, EALData
from eal_actors.facade.fleet import Fleet
from eal_actors.info import ValueInfo
from eal_actors.log import get_logger

POSE_RESOURCE: Final = "Pose"
"""The resource that is asked: its value is [x m, y m, yaw rad] in the world frame."""
_POSE: Final = ValueInfo(DataType.DOUBLE, shape=(3,))


class PoseSample(NamedTuple):
    """A pose in the world frame, and when it was so, in seconds of the fleet's clock."""

    time_s: float
    x_m: float
    y_m: float
    yaw_rad: float


class PoseRecorder:
    """Asks every robot for its pose, period after period, between `with` and its end.

    A robot that does not answer within the period is passed over until the next: recording never holds up a run.
    One whose Pose is no pose is asked no more.

    Args:
        fleet: a connected fleet.
        robots: the names of the robots; those without a Pose are left out.
        period_s: seconds of the fleet's clock between two samples.
    """

    def __init__(self, fleet: Fleet, robots: Iterable[str], period_s: float = 0.1) -> None:
        self._paths: dict[str, list[PoseSample]] = {}
        self._period_s = period_s
        self._clock = fleet.clock
        self._poses: dict[str, ResourceHandle] = {}
        for name in robots:
            if POSE_RESOURCE in fleet[name]:
                self._poses[name] = fleet[name][POSE_RESOURCE]
                self._paths[name] = []
        self._stop = new_waiter()
        self._thread = threading.Thread(target=self._record, name="pose recorder", daemon=True)

    def __enter__(self) -> Self:
        self._clock.start(self._thread)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._clock.wake(self._stop)
        with self._clock.outside():
            self._thread.join()

    def _record(self) -> None:
        if not self._poses:
            return
        stopped = False
        while not stopped:
            asked = self._ask()
            stopped = self._clock.wait(self._stop, self._period_s)
            self._note(asked)
        self._note(self._ask(), wait=True)  # where everybody ended up

    def _ask(self) -> dict[str, Future[EALData]]:
        return {name: pose.get_value(timeout_s=max(self._period_s, 1.0)) for name, pose in self._poses.items()}

    def _note(self, asked: Mapping[str, Future[EALData]], *, wait: bool = False) -> None:
        for name, future in asked.items():
            if (future.done() or wait) and future.exception() is None:
                self._keep(name, future.get())

    def _keep(self, name: str, data: EALData) -> None:
        problem = _POSE.problem(data)
        if problem is None and not all(map(math.isfinite, data.value)):
            problem = f"must be finite, not {data!r}"
        if problem is not None:
            get_logger(robot=name).warning("its path is recorded no more", reason=f"the value of its Pose {problem}")
            del self._poses[name]
            return
        stamp_s = data.stamp_s if data.stamp_s is not None else self._clock.now()
        path = self._paths[name]
        if not path or path[-1].time_s < stamp_s:
            path.append(PoseSample(stamp_s, *map(float, data.value)))

    def paths_since(self, start_s: float) -> dict[str, list[PoseSample]]:
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
