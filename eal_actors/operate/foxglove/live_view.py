"""LiveView: serves a fleet's poses, paths, values, pictures, arena, states and log to viewers, as `run.mcap` has them.

The server is foxglove-sdk's. It keeps a bounded backlog for each viewer and drops the oldest messages of a slow one, so
a viewer never delays the fleet. Only channels that a viewer shows are filled.

Scenes do not change, so each is sent once to each viewer that asks for it.
"""

from __future__ import annotations

import itertools
import json
import logging
import threading
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, Final, Self

import foxglove
from foxglove import Channel, Context
from foxglove.websocket import Capability
from typing_extensions import override

from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle
from eal_actors.actors.many import read_many
from eal_actors.device.data import EALData
from eal_actors.device.info import ResourceType
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import REAL_TIME, new_waiter, wall_time
from eal_actors.kernel.errors import EALError, UnavailableError
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.log_limit import LogLimit
from eal_actors.operate.foxglove.viewer_control import ViewerControl
from eal_actors.recording import messages, schemas
from eal_actors.recording.mcap_file import ARENA_TOPIC, EVENTS_TOPIC, HULLS_TOPIC
from eal_actors.recording.messages import Message
from eal_actors.recording.poses import POSE_RESOURCES, path_resource, pose_sample
from eal_actors.recording.sampler import Sampler, SampleSpec
from eal_actors.recording.schemas import MessageSchema
from eal_actors.recording.timeline import log_entry_of
from eal_actors.recording.value_messages import hull_radii_m, message_of, resource_infos, scanner_angles, topic_of
from eal_actors.scenario.report.events import RunEvent

POSE_RATE_HZ: Final = 20.0
_VALUE_PERIOD_S: Final = 0.2
_STATE_TURNS: Final = 3
_ANSWER_S: Final = 30.0  # deadline of a value: the first picture of a simulated camera takes seconds on a busy machine
_BASE: Final = "Base"
_STATE_TOPIC: Final = "/state"
_TRANSFORMS_TOPIC: Final = "/tf"
_LOG_TOPIC: Final = "/log"
_CLIENT_LOGGER: Final = "foxglove.websocket.connected_client"
_LEVEL_NAMES: Final = ((logging.ERROR, "error"), (logging.WARNING, "warning"), (logging.INFO, "info"), (0, "debug"))


class LiveView:
    """Serves an open fleet between `with` and its end.

    `port` is 0 for any free one. `allow_control` lets viewers drive robots and set configuration keys; see
    ViewerControl. Raises UnavailableError if the port is in use.
    """

    def __init__(self, fleet: Fleet, host: str = "127.0.0.1", port: int = 8765, *, allow_control: bool = False) -> None:
        self._fleet = fleet
        self._host = host
        self._port = port
        self._context = Context()
        self._lock = threading.Lock()
        self._channels: dict[str, Channel] = {}
        self._offset_s = wall_time().timestamp() - fleet.clock.now()
        self._infos = resource_infos(fleet, fleet)
        self._paths = {robot: path_resource(infos) for robot, infos in self._infos.items()}
        tracked = [fleet[robot][name] for robot, name in self._paths.items() if name is not None]
        self._poses = [SampleSpec(resource, 1.0 / POSE_RATE_HZ) for resource in tracked]
        self._values = [value for value in self._sensors() if value.name != self._paths[value.robot]]
        self._bases = [
            fleet[robot][_BASE]
            for robot, infos in self._infos.items()
            if _BASE in infos and any(request.name == "path" for request in infos[_BASE].requests)
        ]
        self._angles = scanner_angles(self._infos, [SampleSpec(value, _VALUE_PERIOD_S) for value in self._values])
        self._transforms: dict[str, Message] = {}
        self._newest_s: dict[str, float] = {}
        self._scenes: dict[str, Message] = {}
        if fleet.config.world is not None:
            self._scenes[ARENA_TOPIC] = messages.scene_message(fleet.config.world)
        if radii_m := hull_radii_m(fleet, self._infos):
            self._scenes[HULLS_TOPIC] = messages.hull_message(radii_m)
        self._control = ViewerControl(fleet) if allow_control else None
        self._sampler = Sampler(fleet.clock, self._poses, self._add_pose)
        self._pending: dict[str, tuple[Future[EALData], Callable[[EALData], None]]] = {}
        self._over = new_waiter()
        self._thread = threading.Thread(target=self._run, name="foxglove", daemon=True)
        self._server: Any = None
        self._lines = _LogLines(self)
        self._client_lines = _ClientLines()

    def __enter__(self) -> Self:
        self._channel(_TRANSFORMS_TOPIC, schemas.TRANSFORMS)
        self._channel(_STATE_TOPIC, schemas.STATE)
        self._channel(_LOG_TOPIC, schemas.LOG)
        for topic in self._scenes:
            self._channel(topic, schemas.SCENE)
        for resource in (*self._values, *(spec.resource for spec in self._poses)):
            self._channel(topic_of(resource), self._schema_of(resource))
        for base in self._bases:
            self._channel(_plan_topic(base), schemas.POSES)
        controls = [Capability.ClientPublish, Capability.Parameters] if self._control is not None else []
        listener: Any = _ViewerListener(self, self._control)  # it has the callbacks of its capabilities alone
        try:
            self._server = foxglove.start_server(
                name=f"EAL actors: {self._fleet.name}",
                host=self._host,
                port=self._port,
                capabilities=controls,
                server_listener=listener,
                supported_encodings=["json"],
                context=self._context,
            )
        except RuntimeError as error:
            raise UnavailableError(f"cannot listen at {self._host}:{self._port}: {error}") from error
        if self._control is not None:
            self._control.start()
        logging.getLogger("eal_actors").addHandler(self._lines)
        logging.getLogger(_CLIENT_LOGGER).addFilter(self._client_lines)
        self._sampler.__enter__()
        self._thread.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        logging.getLogger("eal_actors").removeHandler(self._lines)
        logging.getLogger(_CLIENT_LOGGER).removeFilter(self._client_lines)
        self._sampler.__exit__(*exc_info)
        REAL_TIME.wake(self._over)
        self._thread.join()
        if self._control is not None:
            self._control.close()
        self._server.stop()

    @property
    def url(self) -> str:
        """The address for viewers: `Open connection`, `Foxglove WebSocket`."""
        return f"ws://{self._host}:{self._server.port}"

    # Channels.

    def _channel(self, topic: str, schema: MessageSchema) -> Channel:
        with self._lock:
            if topic not in self._channels:
                named = {"title": schema.name, **schema.schema}
                self._channels[topic] = Channel(topic, schema=named, context=self._context)
            return self._channels[topic]

    def _log(self, topic: str, schema: MessageSchema, message: Message, time_s: float) -> None:
        """Send a message, if a viewer shows its topic."""
        channel = self._channel(topic, schema)
        if channel.has_sinks():
            channel.log(json.dumps(message).encode(), log_time=messages.nanoseconds(time_s))

    def _wall_s(self, clock_s: float) -> float:
        return clock_s + self._offset_s

    def _schema_of(self, resource: ResourceHandle) -> MessageSchema:
        if resource.name in POSE_RESOURCES:
            return schemas.POSE
        if self._infos[resource.robot][resource.name].is_camera:
            return schemas.IMAGE
        return schemas.SCAN if topic_of(resource) in self._angles else schemas.VALUE

    def _sensors(self) -> Iterator[ResourceHandle]:
        for robot, infos in self._infos.items():
            for name, info in infos.items():
                if name in POSE_RESOURCES or (info.value is not None and ResourceType.SENSOR in info.types):
                    yield self._fleet[robot][name]

    # Poses. Thread: the sampler's.

    def _add_pose(self, resource: ResourceHandle, data: EALData) -> bool:
        if (sample := pose_sample(resource, data, self._fleet.clock)) is None:
            return False
        time_s = self._wall_s(sample.time_s)
        if time_s <= self._newest_s.get(topic_of(resource), 0.0):  # the same pose again: a late sampler catches up
            return True
        self._newest_s[topic_of(resource)] = time_s
        sample = sample._replace(time_s=time_s)
        self._log(topic_of(resource), schemas.POSE, messages.pose_message(sample), time_s)
        if resource.name == self._paths[resource.robot]:
            if resource.robot in self._transforms:  # the next round of poses
                transforms = {"transforms": list(self._transforms.values())}
                self._log(_TRANSFORMS_TOPIC, schemas.TRANSFORMS, transforms, time_s)
                self._transforms.clear()
            self._transforms[resource.robot] = messages.transform_of(resource.robot, sample)
        return True

    # Values and states. Thread: the view's own.

    def _run(self) -> None:
        for turn in itertools.count():
            self._read_values()
            if turn % _STATE_TURNS == 0:
                self._send_states()
            if REAL_TIME.wait(self._over, _VALUE_PERIOD_S):
                return

    def _read_values(self) -> None:
        """Send the values that have arrived, and ask for those that a viewer shows: a camera costs much."""
        for topic, (answer, send) in list(self._pending.items()):
            if answer.done():
                del self._pending[topic]
                if answer.exception() is None:
                    send(answer.get())
        wanted = [value for value in self._values if self._is_wanted(topic_of(value))]
        for value, answer in zip(wanted, read_many(wanted, _ANSWER_S), strict=True):
            self._pending[topic_of(value)] = answer, partial(self._send_value, value)
        for base in self._bases:
            if self._is_wanted(topic := _plan_topic(base)):
                self._pending[topic] = base.send_req("path", timeout_s=_ANSWER_S), partial(self._send_plan, topic)

    def _is_wanted(self, topic: str) -> bool:
        return topic not in self._pending and self._channels[topic].has_sinks()

    def _send_plan(self, topic: str, path: EALData) -> None:
        time_s = self._wall_s(self._fleet.clock.now())
        self._log(topic, schemas.POSES, messages.poses_message(time_s, path.value), time_s)

    def _send_value(self, resource: ResourceHandle, data: EALData) -> None:
        if resource.name in POSE_RESOURCES:
            self._add_pose(resource, data)
            return
        time_s = self._wall_s(data.stamp_s if data.stamp_s is not None else self._fleet.clock.now())
        topic = topic_of(resource)
        try:
            schema, message = message_of(resource, data, time_s, self._angles.get(topic))
        except EALError as error:
            get_logger(robot=resource.robot).warning("a value is not shown", reason=error.message)
            return
        self._log(topic, schema, message, time_s)

    # Scenes, states and events.

    def send_scene(self, topic: str) -> None:
        """Send a scene again, for a viewer that has just asked for it. Thread: any."""
        if (scene := self._scenes.get(topic)) is not None:
            now_s = self._wall_s(self._fleet.clock.now())
            self._log(topic, schemas.SCENE, messages.shifted(scene, messages.nanoseconds(now_s)), now_s)

    def _send_states(self) -> None:
        time_s = self._wall_s(self._fleet.clock.now())
        robots = [
            {
                "name": robot.name,
                "state": robot.state.value,
                "stopped": robot.stopped_because or "",
                "running": [f"{command.resource} {command.command}" for command in robot.running],
                "not_ready": [f"{name}: {reason}" for name, reason in robot.not_ready.items()],
            }
            for robot in self._fleet.values()
        ]
        self._log(_STATE_TOPIC, schemas.STATE, {**messages.stamped(time_s), "robots": robots}, time_s)

    def hear(self, event: RunEvent) -> None:
        """Show an event of a run, and its log line; a listener of a Run. Thread: the run's."""
        time_s = self._wall_s(self._fleet.clock.now())
        fields = event.to_dict()
        self._log(EVENTS_TOPIC, schemas.EVENT, {**messages.stamped(time_s), **fields}, time_s)
        if (entry := log_entry_of(fields)) is not None:
            log = messages.log_message(time_s, entry.level, entry.source, entry.text)
            self._log(_LOG_TOPIC, schemas.LOG, log, time_s)

    def show_line(self, level: str, robot: str, text: str) -> None:
        """Show a line of the log. Thread: any; does not block."""
        time_s = self._wall_s(self._fleet.clock.now())
        self._log(_LOG_TOPIC, schemas.LOG, messages.log_message(time_s, level, robot, text), time_s)


def _plan_topic(base: ResourceHandle) -> str:
    return f"/{base.robot}/plan"


class _LogLines(logging.Handler):
    """Gives the framework's log lines to a view. Thread: any."""

    def __init__(self, view: LiveView) -> None:
        super().__init__()
        self._view = view

    @override
    def emit(self, record: logging.LogRecord) -> None:
        fields: dict[str, Any] = getattr(record, "eal", {})
        level = next(name for least, name in _LEVEL_NAMES if record.levelno >= least)
        self._view.show_line(level, str(fields.get("robot", "")), record.getMessage())


class _ClientLines(logging.Filter):
    """Bounds foxglove-sdk's log lines about viewers: it writes one for each wrong message. Thread: any."""

    def __init__(self) -> None:
        super().__init__()
        self._limit = LogLimit()

    @override
    def filter(self, record: logging.LogRecord) -> bool:
        more = self._limit.admit()
        if more:
            record.msg, record.args = f"{record.getMessage()} omitted={more['omitted']}", ()
        return more is not None


class _ViewerListener:
    """Passes the requests of viewers to their view and their control. Thread: the server's."""

    def __init__(self, view: LiveView, control: ViewerControl | None) -> None:
        self._view = view
        if control is not None:
            self.on_client_advertise = control.on_client_advertise
            self.on_client_unadvertise = control.on_client_unadvertise
            self.on_message_data = control.on_message_data
            self.on_get_parameters = control.on_get_parameters
            self.on_set_parameters = control.on_set_parameters

    def on_subscribe(self, client: Any, channel: Any) -> None:  # noqa: ARG002  # the server's interface
        self._view.send_scene(channel.topic)

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        """Do nothing: a channel that no viewer shows is not filled."""

    def on_parameters_subscribe(self, param_names: list[str]) -> None:
        """Do nothing: parameters are sent when they are asked for or set."""

    on_parameters_unsubscribe = on_parameters_subscribe
