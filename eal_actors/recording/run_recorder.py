"""Record a run for people and tools: poses, readings, frames, calls and log lines, in `run.mcap`."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Final, Literal, Self, TypeAlias

from eal_actors.actors.handles import ResourceHandle
from eal_actors.data import DataType, EALData
from eal_actors.errors import EALError, UnsupportedError
from eal_actors.facade.fleet import Fleet
from eal_actors.info import ResourceInfo, ResourceType
from eal_actors.log import get_logger
from eal_actors.net.images import encode_image
from eal_actors.record import messages, schemas
from eal_actors.record.mcap_file import RECORD_FILE, McapFile
from eal_actors.record.pose_sample import PoseSample
from eal_actors.record.recorded_run import INFOS
from eal_actors.recording.poses import POSE_PERIOD_S, POSE_RESOURCE, Paths
from eal_actors.recording.sampler import Sampler, Wish
from eal_actors.scenario.events import Event, LogLine, RobotDropped, RunContinued, RunStarted, StepEnded, StepRetried
from eal_actors.scenario.report import StepRecord

Extent: TypeAlias = Literal["poses", "sensors", "all"]
"""What is recorded beside the run's events: poses; the values of every sensor but images; or those as well."""

SENSOR_PERIOD_S: Final = 0.2
FRAME_PERIOD_S: Final = 0.2
_ANGLES: Final = "angles"
"""The request by which a scanner tells where its rays point."""
RUN: Final = "run"


def is_image(info: ResourceInfo) -> bool:
    """Return whether a resource's values are RGB images."""
    value = info.value
    return (
        value is not None
        and value.type is DataType.CHAR
        and len(value.shape) == 3
        and value.shape[2] == 3
        and ResourceType.SENSOR in info.types
    )


class RunRecorder:
    """Listens to a run and asks its robots, between `with` and its end.

    Args:
        fleet: a connected fleet.
        robots: the names of the robots that take part.
        directory: the run's folder, for `run.mcap`, or `run-2.mcap` and so on where a run goes on that was cut off; it
            must exist. None keeps only the paths, and so does a missing mcap library, which is logged.
        extent: what is asked of the robots.

    Raises:
        OSError: the file cannot be made.
    """

    def __init__(self, fleet: Fleet, robots: Iterable[str], directory: Path | None, extent: Extent = "poses") -> None:
        self._fleet = fleet
        self._clock = fleet.clock
        self._lock = threading.Lock()
        self._start_s: float | None = None
        self._early: dict[str, Callable[[], None]] = {}
        self._infos = _infos(fleet, robots)
        self._angles: Mapping[str, list[float]] = {}
        posers = [robot for robot, infos in self._infos.items() if POSE_RESOURCE in infos]
        self._paths = Paths(posers, fleet.clock)
        self._wishes = tuple(self._wished(extent))
        self._sampler = Sampler(fleet.clock, self._wishes, self._take)
        self._file = _new_file(directory) if directory is not None else None

    def __enter__(self) -> Self:
        if self._file is not None:
            self._guarded(self._open)
            self._angles = _angles(self._infos, self._wishes)
        self._sampler.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._sampler.__exit__(kind, error, traceback)
        self._guarded(lambda file: file.close())

    def paths_since(self, start_s: float) -> dict[str, list[PoseSample]]:
        """Return the robots' poses; see Paths.since."""
        return self._paths.since(start_s)

    def _wished(self, extent: Extent) -> Iterable[Wish]:
        for robot, infos in self._infos.items():
            for name, info in infos.items():
                resource = self._fleet[robot][name]
                if name == POSE_RESOURCE:
                    yield Wish(resource, POSE_PERIOD_S)
                elif extent == "poses" or info.value is None or ResourceType.SENSOR not in info.types:
                    continue
                elif not is_image(info):
                    yield Wish(resource, SENSOR_PERIOD_S)
                elif extent == "all":
                    yield Wish(resource, FRAME_PERIOD_S)

    def _open(self, file: McapFile) -> None:
        config = self._fleet.config
        file.note(RUN, {"fleet": config.name, "seed": str(config.seed)})
        infos = {robot: {name: info.to_dict() for name, info in found.items()} for robot, found in self._infos.items()}
        file.attach(INFOS, infos)
        if config.world is not None:
            file.write("/arena", schemas.SCENE, 0.0, messages.scene_message(config.world))

    # What robots say. Thread: the sampler's.

    def _take(self, resource: ResourceHandle, data: EALData) -> bool:
        stamp_s = data.stamp_s if data.stamp_s is not None else self._clock.now()
        is_pose = resource.name == POSE_RESOURCE
        if is_pose and not self._paths.add(resource.robot, data):
            return False
        write = partial(self._write_pose if is_pose else self._write_value, resource, data)
        with self._lock:
            if self._start_s is None:  # the newest from before the start counts as of the start
                self._early[_topic(resource)] = partial(write, 0.0)
            else:
                write(max(0.0, stamp_s - self._start_s))
        return True

    def _write_pose(self, resource: ResourceHandle, data: EALData, time_s: float) -> None:
        sample = PoseSample(time_s, *map(float, data.value))
        topic = _topic(resource)
        self._guarded(lambda file: file.write(topic, schemas.POSE, time_s, messages.pose_message(sample)))
        transform = messages.transform_message(resource.robot, sample)
        self._guarded(lambda file: file.write("/tf", schemas.TRANSFORMS, time_s, transform))

    def _write_value(self, resource: ResourceHandle, data: EALData, time_s: float) -> None:
        topic = _topic(resource)
        frame_id = data.frame_id or messages.base_frame(resource.robot)
        if data.dtype == "|u1" and data.shape is not None and data.shape[2:] == (3,):
            schema, message = schemas.IMAGE, self._image(data, time_s, frame_id)
        elif (angles_rad := self._angles.get(topic)) and data.shape == (len(angles_rad),):
            schema, message = schemas.SCAN, messages.scan_message(time_s, frame_id, data.value.tolist(), angles_rad)
        else:
            schema, message = schemas.VALUE, messages.value_message(time_s, data)
        if message is not None:
            self._guarded(lambda file: file.write(topic, schema, time_s, message))

    def _image(self, data: EALData, time_s: float, frame_id: str) -> messages.Message | None:
        try:
            return messages.image_message(time_s, frame_id, encode_image(data, "jpeg"), "jpeg")
        except EALError as error:
            get_logger().warning("a frame is not recorded", reason=error.message)
            return None

    # What the run does. Thread: the run's.

    def hear(self, event: Event) -> None:
        """Record an event of the run; the first one tells when it began."""
        with self._lock:
            if isinstance(event, RunStarted | RunContinued) and self._start_s is None:
                self._start_s = self._clock.now() - event.time_s
                for write in self._early.values():
                    write()
                self._early.clear()
            self._write_event(event)
            if isinstance(event, StepEnded) and isinstance(event.answer, EALData):
                self._write_answer(event.record, event.answer)

    def _write_answer(self, record: StepRecord, answer: EALData) -> None:
        """Write what the scenario itself read from a sensor, which costs nobody anything; poses are sampled anyway."""
        robot, name = record.robot or "", record.resource or ""
        if record.kind == "get_value" and name != POSE_RESOURCE and name in self._infos.get(robot, {}):
            stamp_s = (
                answer.stamp_s - self._start_s if answer.stamp_s is not None and self._start_s is not None else None
            )
            self._write_value(self._fleet[robot][name], answer, record.end_s if stamp_s is None else max(0.0, stamp_s))

    def _write_event(self, event: Event) -> None:
        fields = {**messages.stamped(event.time_s), **event.to_dict()}
        self._guarded(lambda file: file.write("/events", schemas.EVENT, event.time_s, fields))
        if isinstance(event, StepEnded) and event.record.is_call:
            record = event.record
            command = _command_message(record)
            self._guarded(lambda file: file.write(f"/{record.robot}/commands", schemas.COMMAND, record.end_s, command))
        if (line := _log_line(event)) is not None:
            log = messages.log_message(event.time_s, *line)
            self._guarded(lambda file: file.write("/log", schemas.LOG, event.time_s, log))

    def _guarded(self, write: Callable[[McapFile], None]) -> None:
        """Write, unless an earlier write failed: a full disk must not end the run, whose journal tells more."""
        if self._file is None:
            return
        try:
            write(self._file)
        except OSError as error:
            get_logger().error("run.mcap ends here", reason=str(error))
            self._file = None


def _new_file(directory: Path) -> McapFile | None:
    path, number = directory / RECORD_FILE, 1
    while path.exists():
        number += 1
        path = directory / f"{Path(RECORD_FILE).stem}-{number}{Path(RECORD_FILE).suffix}"
    try:
        return McapFile(path)
    except UnsupportedError as error:
        get_logger().warning("the run is not recorded for other tools", reason=error.message)
        return None


def _infos(fleet: Fleet, robots: Iterable[str]) -> Mapping[str, Mapping[str, ResourceInfo]]:
    found: dict[str, dict[str, ResourceInfo]] = {}
    for robot in robots:
        found[robot] = {}
        for name, resource in fleet[robot].items():
            try:
                found[robot][name] = resource.info
            except EALError as error:
                get_logger(robot=robot).warning("a resource is not recorded", resource=name, reason=error.message)
    return found


def _topic(resource: ResourceHandle) -> str:
    return f"/{resource.robot}/{resource.name}"


def _angles(infos: Mapping[str, Mapping[str, ResourceInfo]], wishes: Iterable[Wish]) -> dict[str, list[float]]:
    """Return where the rays of each scanner point, by its topic. Thread: waits for the answers."""
    asked = {
        _topic(resource): resource.send_req(_ANGLES)
        for resource, _ in wishes
        if any(request.name == _ANGLES for request in infos[resource.robot][resource.name].requests)
    }
    found = {}
    for topic, answer in asked.items():
        try:
            found[topic] = [float(angle_rad) for angle_rad in answer.get().value]
        except EALError as error:
            get_logger().warning("a scanner does not tell its angles", topic=topic, reason=error.message)
    return found


def _command_message(record: StepRecord) -> messages.Message:
    return {
        **messages.stamped(record.start_s),
        "resource": record.resource,
        "method": record.kind,
        "command": record.command or "",
        "step": record.step,
        "outcome": record.outcome,
        "duration_s": record.end_s - record.start_s,
        "error": record.error.message if record.error is not None else "",
    }


def _log_line(event: Event) -> tuple[str, str, str] | None:
    """Return the level, whose it is, and the text of what people should read."""
    match event:
        case LogLine():
            return "info", event.robot or "scenario", event.text
        case RobotDropped():
            return "error", event.robot, f"dropped: {event.error.message}"
        case StepRetried():
            return (
                "warning",
                event.robot or "scenario",
                f"{event.label}: attempt {event.attempt} failed: {event.error.message}",
            )
        case StepEnded(record=record) if record.error is not None:
            return "error", record.robot or "scenario", f"{record.label} {record.outcome}: {record.error.message}"
    return None
