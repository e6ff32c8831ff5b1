"""Watcher: asks the robots how they are, and tells the hub; nothing here ever waits for a robot or a browser."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, Final

from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle, RobotHandle
from eal_actors.actors.robot_view import Ping, RobotState
from eal_actors.device.data import DataType, EALData, ValueInfo
from eal_actors.device.info import ResourceInfo
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import REAL_TIME, new_waiter
from eal_actors.kernel.errors import EALError
from eal_actors.kernel.log import get_logger
from eal_actors.operate.dashboard.control import Control
from eal_actors.operate.dashboard.doings import Doings
from eal_actors.operate.dashboard.hub import Hub

POSE_PERIOD_S: Final = 0.025
"""Real seconds between two looks at the poses: 40 a second."""
ASK_LOOKS: Final = 2
"""A robot whose pose is not known at a glance is asked for it at each so manieth look; they take turns."""
REST_LOOKS: Final = 8
"""A robot that was at the same place at so many looks is looked at in each so manieth only, until it moves."""
STATE_PERIOD_S: Final = 0.2
_BREATH_S: Final = 0.005
HEALTH_PERIOD_S: Final = 1.0
"""Real seconds between two looks at batteries and links."""
POSE_RESOURCES: Final = ("Pose", "Odometry")
"""Where a robot is: as it truly is, or as it believes by dead reckoning."""
BATTERY_RESOURCE: Final = "Battery"
DRIVE_RESOURCE: Final = "Base"
HERE: Final = "this dashboard"
"""Who holds what nobody of the dashboard has commanded, such as before it was started anew."""
TRAIL_STEP_M: Final = 0.02
TRAIL_POINTS: Final = 300
_POSE: Final = ValueInfo(DataType.DOUBLE, shape=(3,))
_TWIST: Final = (2,)


def takes_twist(info: ResourceInfo) -> bool:
    """Return whether a resource is driven by a twist of m/s and rad/s."""
    return "set_value" in info.methods and info.value is not None and info.value.shape == _TWIST


def infos_of(robot: RobotHandle) -> Iterator[tuple[str, ResourceInfo]]:
    """Yield what the robot's resources say of themselves, as far as they have been up."""
    for name, resource in robot.items():
        try:
            yield name, resource.info
        except EALError:
            continue


class Watcher:
    """Looks at all robots in one thread, between `start` and `close`.

    Poses are asked for only while somebody watches. What has not answered when it is due again is passed over until it
    has, so a slow robot is never swamped.

    Args:
        fleet: a connected fleet.
        hub: what to tell.
        doings: which steps they are at.
        control: who commands what, and is told what we hold.
        is_watched: whether anybody looks; in the watcher's thread.
    """

    def __init__(
        self, fleet: Fleet, hub: Hub, doings: Doings, control: Control, is_watched: Callable[[], bool]
    ) -> None:
        self._fleet = fleet
        self._hub = hub
        self._is_watched = is_watched
        self._sights = {
            name: _Sight(robot, doings, control, number % ASK_LOOKS)
            for number, (name, robot) in enumerate(fleet.items())
        }
        self._state_due_s = self._health_due_s = 0.0
        self._stop = new_waiter()
        self._is_over = False
        self._thread = threading.Thread(target=self._watch, name="dashboard watcher", daemon=True)

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def close(self) -> None:
        """Look no more. Thread: blocks the caller for at most one look."""
        self._is_over = True
        REAL_TIME.wake(self._stop)
        self._thread.join()

    def trails(self) -> dict[str, list[tuple[float, float]]]:
        """Return where each robot was lately, x and y in metres, for a page that has just come. Thread: any."""
        return {name: list(sight.trail) for name, sight in self._sights.items() if sight.trail}

    def _watch(self) -> None:
        due_s = REAL_TIME.now()
        while not self._is_over:
            now_s = REAL_TIME.now()
            due_s = max(due_s, now_s - POSE_PERIOD_S) + POSE_PERIOD_S  # what is late is made up for, but by one look
            try:
                self._look(now_s)
            except Exception:  # noqa: BLE001  # a page that stands still unnoticed would be worse
                get_logger().exception("the dashboard's look at the fleet failed; it is tried again")
                REAL_TIME.wait(self._stop, HEALTH_PERIOD_S)
            REAL_TIME.wait(self._stop, max(due_s - REAL_TIME.now(), _BREATH_S))

    def _look(self, now_s: float) -> None:
        if self._is_watched():
            self._look_at_poses()
        if now_s >= self._health_due_s:
            self._health_due_s = now_s + HEALTH_PERIOD_S
            for sight in self._sights.values():
                sight.learn()
                sight.ask_health()
        if now_s >= self._state_due_s:
            self._state_due_s = now_s + STATE_PERIOD_S
            self._hub.put("robots", {name: sight.state() for name, sight in self._sights.items()})

    def _look_at_poses(self) -> None:
        poses = {}
        for name, sight in self._sights.items():
            if (pose := sight.new_pose()) is not None:
                poses[name] = pose
        self._hub.put("poses", poses)


class _Sight:
    """What is known of one robot, and the questions to it that are open. Thread: the watcher's.

    No question has a deadline of its own: one that passed would have a slow resource restarted.

    Args:
        robot: the robot.
        doings: which steps the robots are at.
        control: who commands what.
        wait_looks: so many looks pass before the first.
    """

    def __init__(self, robot: RobotHandle, doings: Doings, control: Control, wait_looks: int) -> None:
        self._robot = robot
        self._doings = doings
        self._control = control
        self._pose: Future[EALData] | None = None
        self._poser: ResourceHandle | None = None
        self._battery: Future[EALData] | None = None
        self._charge: float | None = None
        self._ping: Future[Ping] | None = None
        self._answer: Ping | None = None
        self._makings: dict[str, Any] = {}
        self._learnt_of: object = None
        self._form: object = None
        self._place: list[float] | None = None
        self._same = 0
        self._wait_looks = wait_looks
        self.trail: deque[tuple[float, float]] = deque(maxlen=TRAIL_POINTS)

    def learn(self) -> None:
        """Look up what seldom changes: which resources there are, and which of them tells the pose."""
        robot, not_ready = self._robot, self._robot.not_ready
        standing = (robot.state, tuple(robot), tuple(not_ready))
        if standing == self._learnt_of:
            return
        self._learnt_of = standing
        infos = dict(infos_of(robot))
        poser = next((name for name in POSE_RESOURCES if name in robot and name not in not_ready), None)
        self._poser = robot[poser] if poser is not None else None
        base = infos.get(DRIVE_RESOURCE)
        self._makings = {
            "type": robot.type,
            "tags": robot.tags,
            "is_remote": robot.is_remote,
            "resources": list(robot),
            "cameras": [name for name, info in infos.items() if info.is_camera],
            "can_drive": base is not None and takes_twist(base),
        }

    # Poses.

    def new_pose(self) -> dict[str, Any] | None:
        """Return where it is, if that is known anew: by a glance, or by a question asked at an earlier look."""
        data = None
        if self._pose is not None and self._pose.done():
            data, self._pose = _outcome(self._pose), None
        if self._wait_looks > 0:
            self._wait_looks -= 1
        elif self._pose is None:
            data = self._look(data)
        if data is None or not self._is_pose(data):
            return None
        x_m, y_m, yaw_rad = map(float, data.value)
        if not all(map(math.isfinite, (x_m, y_m, yaw_rad))):
            return None
        if not self.trail or math.dist(self.trail[-1], (x_m, y_m)) >= TRAIL_STEP_M:
            self.trail.append((round(x_m, 3), round(y_m, 3)))
        place = [round(x_m, 4), round(y_m, 4), round(yaw_rad, 4)]
        self._same = self._same + 1 if place == self._place else 0
        self._place = place
        return {"at": place, "by": self._poser.name if self._poser is not None else None}

    def _look(self, answer: EALData | None) -> EALData | None:
        """Glance at the pose, or ask for it and return the answer there is; rest after it while the robot stands."""
        if self._poser is None or self._robot.state is not RobotState.READY:
            return answer
        self._wait_looks = REST_LOOKS - 1 if self._same >= REST_LOOKS else 0
        seen = self._poser.glance()
        if seen is not None:
            return seen
        self._wait_looks = max(self._wait_looks, ASK_LOOKS - 1)
        self._pose = self._poser.get_value()
        return answer

    def _is_pose(self, data: EALData) -> bool:
        form = data.type, data.shape, data.length
        if form != self._form and _POSE.problem(data) is None:  # which costs more than all the rest of a look
            self._form = form
        return form == self._form

    # How it is.

    def ask_health(self) -> None:
        robot = self._robot
        if robot.state is not RobotState.READY:
            self._answer = None
            return
        if self._battery is None and BATTERY_RESOURCE in robot and BATTERY_RESOURCE not in robot.not_ready:
            self._battery = robot[BATTERY_RESOURCE].get_value()
        if self._ping is None:
            self._ping = robot.ping()

    def _take_health(self) -> None:
        if self._battery is not None and self._battery.done():
            data, self._battery = _outcome(self._battery), None
            number = data.value if data is not None else None
            self._charge = float(number) if isinstance(number, int | float) else None
        if self._ping is not None and self._ping.done():
            self._answer, self._ping = _outcome(self._ping), None
            self._control.let_go(self._robot, self._ours())

    def _ours(self) -> list[str]:
        """Return the resources of a robot of another process that this process holds, as its last ping told."""
        if self._answer is None or self._robot.controller_id is None:
            return []
        return [name for name, holder in self._answer.holder_ids.items() if holder == self._robot.controller_id]

    def _controllers(self) -> dict[str, str]:
        """Return who commands which resource: by the name of a browser or scenario of ours, else as they say."""
        robot, answer = self._robot, self._answer
        if not robot.is_remote or answer is None:
            return self._control.users(robot.name)
        ours = self._ours()
        return {
            name: (self._control.by(robot.name, name) or HERE) if name in ours else holder
            for name, holder in answer.holders.items()
        }

    def _running(self) -> list[dict[str, Any]]:
        """Return the commands under way; `by` is None for our own."""
        robot, ours = self._robot, self._ours()
        return [
            {**running.to_dict(), "by": None if not robot.is_remote or running.resource in ours else running.by}
            for running in robot.running
        ]

    def state(self) -> dict[str, Any]:
        self._take_health()
        robot, answer = self._robot, self._answer
        return {
            **self._makings,
            **self._doings.of(robot.name),
            "state": robot.state.value,
            "stopped": robot.stopped_because,
            "not_ready": robot.not_ready,
            "problems": [problem.message for problem in robot.problems],
            "restarts": {name: count for name, count in robot.restarts.items() if count},
            "battery": None if self._charge is None else round(self._charge, 3),
            "round_trip_ms": round(answer.round_trip_s * 1000, 1) if answer is not None and robot.is_remote else None,
            "control": self._controllers(),
            "running": self._running(),
        }


def _outcome(future: Future[Any] | None) -> Any:
    """Return what a question came to; None if it failed or is open."""
    if future is None or not future.done() or future.exception() is not None:
        return None
    return future.get()
