"""FixForwarder: brings the fixes of a fleet's trackers to the pose estimates of its robots.

Each tracker has one thread, which reads the tracker's newest fixes and sends each robot its own. It never waits for a
robot: a robot that has not taken its last fix misses one. In lock step, the threads live by the fleet's clock like all
others, so runs repeat.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any, Final

from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.streams import Stream
from eal_actors.device.data import DataType, EALData
from eal_actors.device.info import ValueInfo
from eal_actors.kernel.clock import Clock, new_waiter
from eal_actors.kernel.errors import EALError
from eal_actors.kernel.log import get_logger
from eal_actors.managers.fleet_model import FleetConfig

FIXES_RESOURCE: Final = "Fixes"
POSE_RESOURCE: Final = "Pose"
FIX_RATE_HZ: Final = 10.0
"""How often a tracker is read, by the fleet's clock."""
_RETRY_S: Final = 1.0
_JOIN_S: Final = 5.0  # real seconds
_ROW: Final = 13
_FIXES: Final = ValueInfo(DataType.DOUBLE, shape=(None, _ROW))


class FixForwarder:
    """Forwards fixes while a fleet is open. Thread: one at a time."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._threads: dict[str, _TrackerThread] = {}

    def follow(self, config: FleetConfig, robots: Mapping[str, RobotHandle]) -> None:
        """Forward the fixes between the connected robots from now on."""
        wanted: dict[str, dict[int, RobotHandle]] = {}
        for name, robot in robots.items():
            pose = config.robots[name].pose
            for tracker in pose.trackers:
                if tracker in robots and pose.marker is not None:
                    wanted.setdefault(tracker, {})[int(pose.marker)] = robot
        for name in [name for name in self._threads if name not in wanted]:
            self._threads.pop(name).close()
        for name, targets in wanted.items():
            if name in self._threads:
                self._threads[name].targets = targets
            else:
                self._threads[name] = _TrackerThread(self._clock, robots[name], targets)

    def close(self) -> None:
        """End the forwarding. Thread: blocks the caller for a moment."""
        while self._threads:
            self._threads.popitem()[1].close()


class _TrackerThread:
    """Reads one tracker. `targets` are the robots by the numbers of their markers; they are replaced as a whole."""

    def __init__(self, clock: Clock, tracker: RobotHandle, targets: dict[int, RobotHandle]) -> None:
        self.targets = targets
        self._clock = clock
        self._tracker = tracker
        self._stop = new_waiter()
        self._is_closed = False
        self._stream: Stream | None = None
        self._sent: dict[int, Future[Any]] = {}
        self._trouble: dict[str, str] = {}
        self._last_s: float | None = None
        self._thread = threading.Thread(target=self._run, name=f"fixes of {tracker.name}", daemon=True)
        clock.start(self._thread)

    def close(self) -> None:
        self._is_closed = True
        if self._stream is not None:
            self._stream.close()
        self._clock.wake(self._stop)
        with self._clock.outside():
            self._thread.join(_JOIN_S)

    def _run(self) -> None:
        while not self._is_closed:
            try:
                with self._tracker[FIXES_RESOURCE].stream(FIX_RATE_HZ) as self._stream:
                    while not self._is_closed:
                        self._forward(next(self._stream))
            except StopIteration:
                return
            except EALError as error:
                self._note(self._tracker.name, "a tracker gives no fixes", error.message)
                self._clock.wait(self._stop, _RETRY_S)

    def _forward(self, data: EALData) -> None:
        if problem := _FIXES.problem(data):
            self._note(self._tracker.name, "a tracker gives no fixes", f"its {FIXES_RESOURCE} {problem}")
            return
        if data.stamp_s is None or data.stamp_s == self._last_s:
            return
        self._last_s = data.stamp_s
        self._trouble.pop(self._tracker.name, None)
        targets = self.targets
        numbers = data.value if isinstance(data.value, list | tuple) else data.value.ravel().tolist()
        for place in range(0, len(numbers), _ROW):
            number = numbers[place]
            if number not in targets:  # also no number at all
                continue
            marker, robot = int(number), targets[int(number)]
            if self._is_free(marker, robot):
                pose = list(numbers[place + 1 : place + _ROW])
                self._send(marker, robot, EALData.of(pose, frame_id=data.frame_id, stamp_s=data.stamp_s))

    def _send(self, marker: int, robot: RobotHandle, fix: EALData) -> None:
        try:
            self._sent[marker] = robot[POSE_RESOURCE].send_cmd("fix", fix)
        except EALError as error:  # the robot has no Pose
            self._note(robot.name, "a robot gets no fixes", error.message)

    def _is_free(self, marker: int, robot: RobotHandle) -> bool:
        """Return whether a robot has taken its last fix."""
        if (sent := self._sent.get(marker)) is None:
            return True
        if not sent.done():
            return False
        if (error := sent.exception()) is None:
            self._trouble.pop(robot.name, None)
        else:
            self._note(robot.name, "a robot gets no fixes", str(error))
        return True

    def _note(self, robot: str, event: str, reason: str) -> None:
        """Log a trouble once, until it is over."""
        if robot not in self._trouble and not self._is_closed:
            self._trouble[robot] = reason
            get_logger(robot=robot).warning(event, reason=reason)
