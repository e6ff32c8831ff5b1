"""FleetMap: the live map of a fleet in a notebook.

from eal_actors.operate.notebook import FleetMap

FleetMap(fleet)
"""

from __future__ import annotations

import contextlib
import threading
from pathlib import Path
from typing import Any, Final

import anywidget
import traitlets

from eal_actors.actors.combine import gather
from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import RobotState
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import REAL_TIME, new_waiter
from eal_actors.kernel.errors import EALError, WaitTimeoutError
from eal_actors.operate.dashboard.fleet_poller import POSE_RESOURCES
from eal_actors.operate.dashboard.world_map import world_map

_PERIOD_S: Final = 0.2
_ANSWER_S: Final = 1.0
STOP_REASON: Final = "STOP in a notebook"


class FleetMap(anywidget.AnyWidget):
    """The live map of a connected fleet: walls, obstacles and robots, and a STOP button.

    It follows the fleet between its construction and `close`, or the end of the fleet. Thread: a thread of its own asks
    the robots, five times a second.
    """

    _esm = Path(__file__).with_name("fleet_map.js")
    world = traitlets.Dict(allow_none=True).tag(sync=True)
    poses = traitlets.Dict().tag(sync=True)
    """x and y in metres and yaw in radians, by robot."""
    states = traitlets.Dict().tag(sync=True)
    """A word for each robot; empty when the fleet is closed."""

    def __init__(self, fleet: Fleet) -> None:
        super().__init__(world=world_map(fleet.config.world))
        self._fleet = fleet
        self._waiter = new_waiter()
        self._is_over = False
        self._thread = threading.Thread(target=self._follow, name="notebook map", daemon=True)
        self.on_msg(lambda _, message, __: self.stop_robots() if message == "stop" else None)
        self.update()
        self._thread.start()

    def stop_robots(self) -> None:
        """Stop every robot: the emergency stop. Thread: any; does not block."""
        for robot in self._fleet.values():
            robot.stop(STOP_REASON)

    def update(self) -> None:
        """Ask every robot for its pose, and show those that answer. Thread: blocks at most for a second."""
        answers = {name: answer for name, robot in self._fleet.items() if (answer := _ask(robot)) is not None}
        done = gather(answers.values(), return_exceptions=True)
        with contextlib.suppress(WaitTimeoutError):
            done.get(timeout=self._fleet.clock.of_real(_ANSWER_S))
        self.states = {name: _state_of(robot) for name, robot in self._fleet.items()}
        self.poses = {
            name: [float(number) for number in answer.get().value]
            for name, answer in answers.items()
            if answer.done() and answer.exception() is None
        }

    def close(self) -> None:
        """End the map; idempotent. Thread: blocks until its thread has ended."""
        self._is_over = True
        REAL_TIME.wake(self._waiter)
        if threading.current_thread() is not self._thread and self._thread.is_alive():
            self._thread.join()
        super().close()

    def _follow(self) -> None:
        while not self._is_over and len(self._fleet):
            REAL_TIME.wait(self._waiter, _PERIOD_S)
            if not self._is_over:
                self.update()
        self.states = self.poses = {}


def _state_of(robot: RobotHandle) -> str:
    if robot.stopped_because is not None and not robot.is_stop_confirmed:
        return "stop NOT CONFIRMED"
    if robot.stopped_because is not None and robot.state is RobotState.READY:
        return "emergency stop"
    return robot.state.value


def _ask(robot: RobotHandle) -> Any:
    resource = next((name for name in POSE_RESOURCES if name in robot), None)
    try:
        return robot[resource].get_value() if resource is not None else None
    except EALError:
        return None
