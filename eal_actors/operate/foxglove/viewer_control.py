"""ViewerControl: the commands of viewers: velocities of robots, and configuration keys as parameters.

A viewer that publishes geometry_msgs/Twist as JSON to `/<robot>/cmd_vel`, such as Foxglove's Teleop panel, drives the
robot under its lease, with the dead-man's switch of the dashboard. Parameters are `<robot>.<resource>.<key>`.
"""

from __future__ import annotations

import math
import threading
from contextlib import suppress
from typing import Any, Final

from foxglove.websocket import Parameter

from eal_actors.actors.future import Future
from eal_actors.device.data import EALData
from eal_actors.device.data.texts import finite_json
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import EALError
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.log_limit import LogLimit
from eal_actors.operate.dashboard.control import ControlRegistry
from eal_actors.operate.dashboard.teleop import DRIVE_RESOURCE, Teleop, Twist
from eal_actors.operate.dashboard.values import infos_of

_SUFFIX: Final = "/cmd_vel"
_ANSWER_S: Final = 2.0
_MOST_SHOWN: Final = 200  # characters of a viewer's text in a log line


class ViewerControl:
    """The commands of viewers.

    Thread: the callbacks run in the server's thread; parameters wait for the robots at most _ANSWER_S each.
    """

    def __init__(self, fleet: Fleet) -> None:
        self._fleet = fleet
        self._answer_s = fleet.clock.of_real(_ANSWER_S)
        self._registry = ControlRegistry()
        self._teleop = Teleop(fleet, self._registry)
        self._lock = threading.Lock()
        self._robots: dict[tuple[int, int], str] = {}
        self._presses: dict[str, int] = {}
        self._ignored = LogLimit()

    def start(self) -> None:
        """Start the dead-man's switch."""
        self._teleop.start()

    def close(self) -> None:
        """Halt every robot that a viewer drives."""
        self._teleop.close()

    # Driving.

    def on_client_advertise(self, client: Any, channel: Any) -> None:
        """Record the robot that a viewer's topic drives."""
        robot = channel.topic.removesuffix(_SUFFIX).strip("/")
        if channel.topic.endswith(_SUFFIX) and robot in self._fleet and channel.encoding == "json":
            self._robots[client.id, channel.id] = robot
        elif (more := self._ignored.admit()) is not None:
            topic, encoding = channel.topic[:_MOST_SHOWN], channel.encoding[:_MOST_SHOWN]
            get_logger().warning("a viewer's topic drives no robot", topic=topic, encoding=encoding, **more)

    def on_client_unadvertise(self, client: Any, client_channel_id: int) -> None:
        """Halt the robot of a topic that is given up, as when a viewer leaves."""
        if (robot := self._robots.pop((client.id, client_channel_id), None)) is not None:
            self._teleop.release(_name(client), robot)
            self._release(robot)

    def on_message_data(self, client: Any, client_channel_id: int, data: bytes) -> None:
        """Drive a robot by a message."""
        if (robot := self._robots.get((client.id, client_channel_id))) is None:
            return
        viewer = _name(client)
        try:
            twist = _twist(data)
        except (ValueError, KeyError, TypeError, OverflowError) as error:
            if (more := self._ignored.admit()) is not None:
                reason = repr(error)[:_MOST_SHOWN]
                get_logger(robot=robot).warning("a viewer's velocity is ignored", reason=reason, **more)
            return
        try:
            self._teleop.drive(viewer, robot, self._press_of(viewer), twist, self._on_error)
        except EALError as error:
            self._on_error(robot, error)

    def _press_of(self, viewer: str) -> int:
        with self._lock:
            return self._presses.setdefault(viewer, 0)

    def _on_error(self, robot: str, error: EALError) -> None:
        """End the presses: a viewer has no keys, so its next message begins a new one."""
        with self._lock:
            for viewer in self._presses:
                self._presses[viewer] += 1
        get_logger(robot=robot).info("a viewer no longer drives it", reason=error.message)
        self._release(robot)

    def _release(self, robot: str) -> None:
        try:
            self._registry.release_idle(self._fleet[robot], [DRIVE_RESOURCE])
        except EALError as error:
            get_logger(robot=robot).debug("its base could not be released", reason=error.message)

    # Parameters.

    def on_get_parameters(self, client: Any, param_names: list[str], request_id: str | None = None) -> list[Parameter]:  # noqa: ARG002
        """Return configuration keys; all of them for no names."""
        every = (
            f"{robot.name}.{resource}.{config.name}"
            for robot in self._fleet.values()
            for resource, info in infos_of(robot)
            for config in info.configs
        )
        return self._read(param_names or list(every))

    def on_set_parameters(
        self,
        client: Any,  # noqa: ARG002
        parameters: list[Parameter],
        request_id: str | None = None,  # noqa: ARG002
    ) -> list[Parameter]:
        """Set configuration keys; returns their values afterwards, the former ones of those that were refused."""
        for parameter in parameters:
            try:
                robot, resource, key = _split(parameter.name)
                self._fleet[robot][resource].set_config(key, parameter.get_value()).get(timeout=self._answer_s)
            except (EALError, ValueError) as error:
                if (more := self._ignored.admit()) is not None:
                    name, reason = parameter.name[:_MOST_SHOWN], str(error)[:_MOST_SHOWN]
                    get_logger().warning("a parameter is not set", name=name, reason=reason, **more)
        return self._read([parameter.name for parameter in parameters])

    def _read(self, names: list[str]) -> list[Parameter]:
        """Return those that can be read; all are asked at once, so that a robot that hangs costs its time-out once."""
        asked: dict[str, Future[EALData]] = {}
        for name in names:
            with suppress(EALError, ValueError):
                robot, resource, key = _split(name)
                asked[name] = self._fleet[robot][resource].get_config(key)
        end_s = REAL_TIME.now() + _ANSWER_S
        found = []
        for name, answer in asked.items():
            try:
                value = answer.get(timeout=self._fleet.clock.of_real(max(0.0, end_s - REAL_TIME.now()))).value
            except EALError as error:
                get_logger().debug("a parameter cannot be read", name=name, reason=str(error))
                continue
            if isinstance(value, bool | int | float | str):
                found.append(Parameter(name, value=value))
        return found


def _twist(data: bytes) -> Twist:
    """Return the velocity in a message; raises ValueError, KeyError, TypeError or OverflowError for another one."""
    fields = finite_json(data)
    twist = Twist(float(fields["linear"]["x"]), float(fields["angular"]["z"]))
    if not all(map(math.isfinite, twist)):  # "nan" as a text
        raise ValueError("it is not finite")
    return twist


def _split(name: str) -> tuple[str, str, str]:
    """Return robot, resource and key; a resource may have a dot in its name. Raise ValueError if a part is missing."""
    robot, _, rest = name.partition(".")
    resource, _, key = rest.rpartition(".")
    if not resource:
        raise ValueError(f"{name!r} is not <robot>.<resource>.<key>")
    return robot, resource, key


def _name(client: Any) -> str:
    return f"foxglove viewer {client.id}"
