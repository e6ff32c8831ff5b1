"""Where the robots of a fleet stand, and how large they are."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Final

from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import RobotState
from eal_actors.device.localization.pose_estimate import Point, PoseEstimate
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import EALError, LocalizationError, NotReadyError
from eal_actors.kernel.log import get_logger

DEFAULT_RADIUS_M: Final = 0.2
"""Of a robot whose base does not tell its own."""
_READ_TIMEOUT_S: Final = 3.0
_LOST_M: Final = 3.0  # a robot with a greater standard deviation of its position has had no fix yet
_FIRST_FIX_S: Final = 10.0
_READY_S: Final = 3.0  # a base on a busy computer or a slow wire may be silent for so long
_FIRST_FIX_LOOK_S: Final = 0.2
_LOST: Final = (
    f"its place is unknown: no fix came within {_FIRST_FIX_S:g} s; bring it into view of its tracker, or set its Pose"
)


class RobotPositions:
    """The last known places of the robots of a fleet.

    `places` says by the robot's name where it is; of a robot that failed on its way, both ends of its last move.
    `known` are the robots that told their place when they were asked last.
    """

    def __init__(self, robots: Mapping[str, RobotHandle]) -> None:
        self._robots = robots
        self.places: dict[str, tuple[Point, ...]] = {}
        self.radii_m: dict[str, float] = {}
        self.known: list[str] = []

    def read(self, travelling: Collection[str], clock: Clock) -> dict[str, EALError]:
        """Ask all robots; return the errors of those that travel and whose pose is unknown.

        Of others that do not answer, the last known place counts. A robot that has just started and does not know where
        it is waits for its first fix. Thread: blocks the caller for some seconds of the clock at most.
        """
        for name in self.places.keys() - self._robots.keys():  # a reload has taken them out of the fleet
            del self.places[name]
        timeout_s = clock.of_real(_READ_TIMEOUT_S)
        robots = {name: robot for name, robot in self._robots.items() if "Base" in robot and "Pose" in robot}
        poses, lost = _poses(robots, travelling, clock, timeout_s)
        for name, robot in robots.items():
            if name not in self.radii_m:
                self.radii_m[name] = radius_m_of(robot, timeout_s=timeout_s)
        self.known = []
        errors: dict[str, EALError] = {}
        for name, pose in poses.items():
            error: BaseException | None = LocalizationError(_LOST, robot=name) if name in lost else pose.exception()
            if error is None:
                self.known.append(name)
                self.places[name] = ((pose.get().x_m, pose.get().y_m),)
            elif name in travelling:
                errors[name] = error if isinstance(error, EALError) else EALError(str(error), robot=name)
            elif name not in self.places and robots[name].state is RobotState.READY:
                get_logger(robot=name).warning("its place is unknown: nobody can drive round it", reason=str(error))
        return errors


def _poses(
    robots: Mapping[str, RobotHandle], travelling: Collection[str], clock: Clock, timeout_s: float
) -> tuple[dict[str, Future[PoseEstimate]], list[str]]:
    """Return the poses of robots, and those that travel without knowing where they are.

    It waits for the fixes of these, and a while for those whose base does not answer.
    """
    begun_s = clock.now()
    while True:
        poses = {name: robot.pose.get(timeout_s=timeout_s) for name, robot in robots.items()}
        lost = [name for name, pose in poses.items() if name in travelling and _is_lost(pose)]
        silent = [name for name in travelling if name in poses and isinstance(poses[name].exception(), NotReadyError)]
        waited_s = clock.now() - begun_s
        if not (lost and waited_s < _FIRST_FIX_S) and not (silent and waited_s < _READY_S):
            return poses, lost
        clock.sleep(_FIRST_FIX_LOOK_S)


def _is_lost(pose: Future[PoseEstimate]) -> bool:
    """Return whether a robot answers, but does not know where it is. Thread: blocks the caller until it answers."""
    return pose.exception() is None and pose.get().position_std_m > _LOST_M


def radius_m_of(robot: RobotHandle, *, timeout_s: float | None = None) -> float:
    """Return the radius of a robot's hull, or a default if its base does not tell it. Thread: blocks the caller."""
    try:
        radius_m = float(robot["Base"].get_config("radius_m", timeout_s=timeout_s).get().value)
    except (EALError, TypeError, ValueError):  # the robot may send anything
        return DEFAULT_RADIUS_M
    return radius_m if 0 < radius_m < math.inf else DEFAULT_RADIUS_M
