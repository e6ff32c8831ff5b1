"""FleetPoller: reads the robots' states into the store.

It never waits for a robot: a question whose answer is open is not asked again, so a slow robot is never swamped.
Questions have no deadline of their own, because a missed deadline would restart a resource that is only slow.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable
from datetime import timedelta
from typing import Any, Final

from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle, RobotHandle
from eal_actors.actors.robot_view import Ping, RobotState
from eal_actors.device.data import DataType, EALData
from eal_actors.device.info import ValueInfo
from eal_actors.device.localization.pose_estimate import PoseEstimate
from eal_actors.kernel.clock import REAL_TIME, Clock, new_waiter, wall_time
from eal_actors.kernel.log import get_logger
from eal_actors.operate.dashboard.control import ControlRegistry, DashboardContext
from eal_actors.operate.dashboard.robot_shape import RobotShape
from eal_actors.operate.dashboard.state_store import CurrentSteps
from eal_actors.operate.dashboard.teleop import DRIVE_RESOURCE, takes_twist
from eal_actors.operate.dashboard.values import ValuePoller, infos_of

POSE_PERIOD_S: Final = 0.025
"""Real seconds between polls of the poses: 40 a second."""
ASK_POLLS: Final = 2
"""A pose that cannot be read without asking the robot is asked for every Nth poll; the robots take turns."""
REST_POLLS: Final = 8
"""A robot whose pose has not changed for N polls is polled only every Nth time, until it moves."""
STATE_PERIOD_S: Final = 0.2
_LEAST_WAIT_S: Final = 0.005
HEALTH_PERIOD_S: Final = 1.0
"""Real seconds between polls of batteries and links."""
POSE_RESOURCES: Final = ("Pose", "Odometry")
"""The true pose, else the pose by dead reckoning."""
OLD_S: Final = 3.0
"""Real seconds after which a pose or charge that is not known anew is old: the one is marked, the other not shown."""
_OLDEST_S: Final = 1e8
"""Real seconds. A robot may stamp a pose with a time that no calendar has."""
BATTERY_RESOURCE: Final = "Battery"
HERE: Final = "this dashboard"
"""The controller of a resource that this process holds but has not commanded since the dashboard started."""
_SPREAD: Final = ((0, 0), (0, 1), (1, 1))  # the elements of a covariance that describe the ellipse of the position
TRAIL_STEP_M: Final = 0.02
TRAIL_POINTS: Final = 300
_POSE: Final = ValueInfo(DataType.DOUBLE, shape=(3,))


class FleetPoller:
    """Polls all robots of a connected fleet in one thread, between `start` and `close`.

    Poses are polled only while `is_watched` returns True; it is called in the poller's thread. `values` follows the
    robots whose pages are open.
    """

    def __init__(self, context: DashboardContext, values: ValuePoller, is_watched: Callable[[], bool]) -> None:
        self._fleet, self._store, self._steps, self._control = context
        self._values = values
        self._is_watched = is_watched
        self._pollers: dict[str, _RobotPoller] = {}
        self._state_due_s = self._health_due_s = 0.0
        self._stop = new_waiter()
        self._is_over = False
        self._thread = threading.Thread(target=self._run, name="dashboard poller", daemon=True)

    def start(self) -> None:
        """Start to poll."""
        self._thread.start()

    def close(self) -> None:
        """Stop polling. Thread: blocks the caller for at most one poll."""
        self._is_over = True
        REAL_TIME.wake(self._stop)
        self._thread.join()

    def trails(self) -> dict[str, list[tuple[float, float]]]:
        """Return each robot's latest positions, x and y in metres, for a new page. Thread: any."""
        return {name: list(poller.trail) for name, poller in self._pollers.items() if poller.trail}

    def _run(self) -> None:
        due_s = REAL_TIME.now()
        while not self._is_over:
            now_s = REAL_TIME.now()
            due_s = max(due_s, now_s - POSE_PERIOD_S) + POSE_PERIOD_S  # a late poll is made up for, but only one
            try:
                self._poll(now_s)
            except Exception:  # noqa: BLE001  # a page that silently stops updating would be worse
                get_logger().exception("the dashboard could not poll the fleet; it will try again")
                REAL_TIME.wait(self._stop, HEALTH_PERIOD_S)
            REAL_TIME.wait(self._stop, max(due_s - REAL_TIME.now(), _LEAST_WAIT_S))

    def _follow_fleet(self) -> None:
        """Poll the robots that the fleet has now; tell browsers of those that a reload has removed."""
        fleet = dict(self._fleet)
        for name in self._pollers.keys() - fleet.keys():
            self._store.put("robots", {name: None})
            self._store.remove("poses", name)
        self._pollers = {
            name: self._pollers.get(name)
            or _RobotPoller(robot, self._fleet.clock, self._steps, self._control, number % ASK_POLLS)
            for number, (name, robot) in enumerate(fleet.items())
        }

    def _poll(self, now_s: float) -> None:
        if self._pollers.keys() != self._fleet.keys():
            self._follow_fleet()
        if self._is_watched():
            read = {name: poller.poll_pose(now_s) for name, poller in self._pollers.items()}
            poses = {name: pose for name, pose in read.items() if pose is not None}
            self._store.put("poses", poses)
        self._values.poll(now_s)
        if now_s >= self._health_due_s:
            self._health_due_s = now_s + HEALTH_PERIOD_S
            for poller in self._pollers.values():
                poller.read_description()
                poller.ask_health()
        if now_s >= self._state_due_s:
            self._state_due_s = now_s + STATE_PERIOD_S
            self._store.put("robots", {name: poller.state() for name, poller in self._pollers.items()})


class _RobotPoller:
    """The state of one robot, and the open questions to it. Thread: the poller's."""

    def __init__(
        self, robot: RobotHandle, clock: Clock, steps: CurrentSteps, control: ControlRegistry, skip_polls: int
    ) -> None:
        self._robot = robot
        self._clock = clock
        self._steps = steps
        self._control = control
        self._pose: Future[EALData] | None = None
        self._pose_resource: ResourceHandle | None = None
        self._battery: Future[EALData] | None = None
        self._charge: float | None = None
        self._charge_s = self._place_s = self._polled_s = 0.0
        self._place_seen: str | None = None
        self._ping: Future[Ping] | None = None
        self._estimate: Future[PoseEstimate] | None = None
        self._has_estimate = False
        self._spread_m2: list[float] | None = None
        self._answer: Ping | None = None
        self._seen: str | None = None
        self._shape = RobotShape(robot)
        self._description: dict[str, Any] = {}
        self._described: object = None
        self._form: object = None
        self._place: list[float] | None = None
        self._same = 0
        self._skip_polls = skip_polls
        self.trail: deque[tuple[float, float]] = deque(maxlen=TRAIL_POINTS)

    def read_description(self) -> None:
        """Read the resources and their descriptions, unless nothing has changed."""
        robot, not_ready = self._robot, self._robot.not_ready
        current = (robot.starts, robot.state, robot.type, tuple(robot.tags), tuple(robot), tuple(not_ready))
        if current == self._described:
            return
        self._described = current
        infos = dict(infos_of(robot))
        pose = next((name for name in POSE_RESOURCES if name in robot and name not in not_ready), None)
        self._pose_resource = robot[pose] if pose is not None else None
        self._shape.describe(infos)
        base, estimate = infos.get(DRIVE_RESOURCE), infos.get(POSE_RESOURCES[0])
        self._has_estimate = estimate is not None and any(one.name == "estimate" for one in estimate.requests)
        self._description = {
            "type": robot.type,
            "tags": robot.tags,
            "is_remote": robot.is_remote,
            "resources": list(robot),
            "cameras": [name for name, info in infos.items() if info.is_camera],
            "can_drive": base is not None and takes_twist(base),
            "can_go": base is not None and any(one.name == "follow" for one in base.commands) and self._has_estimate,
        }

    # Poses.

    def poll_pose(self, now_s: float) -> dict[str, Any] | None:
        """Return the pose if it is known anew: read without asking, or the answer to an earlier question."""
        if now_s > self._polled_s + OLD_S:  # nobody has watched
            self._place_s = self._clock.now()
        self._polled_s = now_s
        data = None
        if self._pose is not None and self._pose.done():
            data, self._pose = _result_or_none(self._pose), None
        if self._skip_polls > 0:
            self._skip_polls -= 1
        elif self._pose is None and (read := self._read_pose()) is not None:
            data = read
        return self._take_pose(data) if data is not None and self._is_pose(data) else None

    def _take_pose(self, data: EALData) -> dict[str, Any] | None:
        x_m, y_m, yaw_rad = map(float, data.value)
        if not all(map(math.isfinite, (x_m, y_m, yaw_rad))):
            return None
        if not self.trail or math.dist(self.trail[-1], (x_m, y_m)) >= TRAIL_STEP_M:
            self.trail.append((round(x_m, 3), round(y_m, 3)))
        place = [round(x_m, 4), round(y_m, 4), round(yaw_rad, 4)]
        self._same = self._same + 1 if place == self._place else 0
        self._place = place
        self._place_s = self._clock.now() if data.stamp_s is None else data.stamp_s
        self._place_seen = None
        return {"at": place, "by": self._pose_resource.name if self._pose_resource is not None else None}

    def _old_pose(self) -> str | None:
        """Return when the pose was measured, by the wall clock, if that was long ago."""
        age_s = (self._clock.now() - self._place_s) / self._clock.of_real(1.0)
        if self._place is None or age_s <= OLD_S:
            return None
        if self._place_seen is None:
            age = timedelta(seconds=min(age_s, _OLDEST_S))
            self._place_seen = (wall_time() - age).isoformat(timespec="seconds")
        return self._place_seen

    def _read_pose(self) -> EALData | None:
        """Return the pose if it can be read without asking; else ask for it."""
        if self._pose_resource is None or self._robot.state is not RobotState.READY:
            return None
        self._skip_polls = REST_POLLS - 1 if self._same >= REST_POLLS else 0
        if (seen := self._pose_resource.glance()) is None:
            self._skip_polls = max(self._skip_polls, ASK_POLLS - 1)
            self._pose = self._pose_resource.get_value()
        return seen

    def _is_pose(self, data: EALData) -> bool:
        form = data.type, data.shape, data.length
        if form != self._form and _POSE.problem(data) is None:  # checked once: it costs more than the rest of a poll
            self._form = form
        return form == self._form

    # Health and control.

    def ask_health(self) -> None:
        robot = self._robot
        if robot.state is not RobotState.READY:
            self._answer = None
            return
        if self._battery is None and BATTERY_RESOURCE in robot and BATTERY_RESOURCE not in robot.not_ready:
            self._battery = robot[BATTERY_RESOURCE].get_value()
        if self._estimate is None and self._has_estimate and POSE_RESOURCES[0] not in robot.not_ready:
            self._estimate = robot.pose.get()
        if self._ping is None:
            self._ping = robot.ping()
        self._shape.ask()

    def _take_answers(self) -> None:
        if self._battery is not None and self._battery.done():
            data, self._battery = _result_or_none(self._battery), None
            number = data.value if data is not None else None
            self._charge = float(number) if isinstance(number, int | float) else None
            self._charge_s = REAL_TIME.now()
        if self._estimate is not None and self._estimate.done():
            estimate, self._estimate = _result_or_none(self._estimate), None
            spread = None if estimate is None else [estimate.covariance[row][column] for row, column in _SPREAD]
            self._spread_m2 = None if spread is None else [round(number, 7) for number in spread]
        if self._ping is not None and self._ping.done():
            self._answer, self._ping = _result_or_none(self._ping), None
            if self._answer is not None:
                self._seen = wall_time().isoformat(timespec="seconds")
            self._control.release_idle(self._robot, self._ours())

    def _ours(self) -> list[str]:
        """Return the resources of a remote robot that this process holds, by its last ping."""
        if self._answer is None or self._robot.controller_id is None:
            return []
        return [name for name, holder in self._answer.holder_ids.items() if holder == self._robot.controller_id]

    def _controllers(self, ours: list[str]) -> dict[str, str]:
        """Return controllers by resource: a browser or scenario of ours, or the holder that the robot reports."""
        robot, answer = self._robot, self._answer
        if not robot.is_remote or answer is None:
            return self._control.users(robot.name)
        return {
            name: (self._control.by(robot.name, name) or HERE) if name in ours else holder
            for name, holder in answer.holders.items()
        }

    def state(self) -> dict[str, Any]:
        self._take_answers()
        robot, answer, ours = self._robot, self._answer, self._ours()
        warnings = () if answer is None else answer.warnings
        charge = self._charge if REAL_TIME.now() <= self._charge_s + OLD_S else None
        return {
            **self._description,
            **self._shape.to_dict(),
            **self._steps.of(robot.name),
            "state": robot.state.value,
            "stopped": robot.stopped_because,
            "is_stop_confirmed": robot.is_stop_confirmed,
            "not_ready": robot.not_ready,
            "problems": [*_not_repeated([problem.message for problem in robot.problems]), *warnings],
            "last_seen": self._seen if robot.state is RobotState.LOST else None,
            "spread_m2": self._spread_m2,
            "pose_seen": self._old_pose(),
            "battery": None if charge is None else round(charge, 3),
            "round_trip_ms": round(answer.round_trip_s * 1000, 1) if answer is not None and robot.is_remote else None,
            "control": self._controllers(ours),
            "running": [
                {**running.to_dict(), "by": running.by if robot.is_remote and running.resource not in ours else None}
                for running in robot.running
            ],
        }


def _not_repeated(texts: list[str]) -> list[str]:
    """Return the texts that no other one contains: a failed robot repeats why its plugins failed."""
    return [text for text in texts if not any(text != other and text in other for other in texts)]


def _result_or_none(future: Future[Any]) -> Any:
    """Return the result of a future that is done; None if it failed."""
    return None if future.exception() is not None else future.get()
