"""The recorder of a run: poses to `trajectory.csv`; poses, values, images, calls and events to `run.mcap`."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, Literal, Self, TypeAlias

from eal_actors.actors.handles import ResourceHandle
from eal_actors.device.data import EALData
from eal_actors.device.info import ResourceType
from eal_actors.device.picture_log import Findings, PictureLog
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import wall_time
from eal_actors.kernel.errors import EALError, UnsupportedError
from eal_actors.kernel.lock_step import MAX
from eal_actors.kernel.log import get_logger
from eal_actors.recording import mcap_file, messages, schemas
from eal_actors.recording.mcap_file import RECORD_FILE, McapFile, pose_topic
from eal_actors.recording.mcap_records import StoredMessage, is_whole
from eal_actors.recording.poses import (
    POSE_PERIOD_S,
    POSE_RESOURCES,
    ROUNDING_S,
    PoseSample,
    TrajectoryTable,
    path_resource,
    pose_sample,
)
from eal_actors.recording.recorded_run import INFOS
from eal_actors.recording.repair import PART_FILE, merge_record
from eal_actors.recording.run_folder import TRAJECTORY, RunFolder
from eal_actors.recording.sampler import Sampler, SampleSpec
from eal_actors.recording.value_messages import hull_radii_m, message_of, resource_infos, scanner_angles, topic_of
from eal_actors.scenario.report.events import RunContinued, RunEvent, RunStarted, StepEnded
from eal_actors.scenario.report.summary import StepRecord

Extent: TypeAlias = Literal["poses", "sensors", "all"]
"""The extent of a record beside events: poses; also the values of all sensors except cameras; also images."""

SENSOR_PERIOD_S: Final = 0.2
FRAME_PERIOD_S: Final = 0.2
RUN: Final = "run"


@dataclass(frozen=True, slots=True)
class RepeatedPast:
    """The past of a run that repeats another run: its samples are copied, which is quicker than to take them again.

    Attributes:
        run: the other run.
        until_s: samples before this time are copied, in seconds since the run's start, to a thousandth.
        start_s: the run's start by the fleet's clock.
        same_s: before this time of the run, its world is the same. Nobody draws a picture of it again: what was found
            in it is read back.
    """

    run: RunFolder
    until_s: float
    start_s: float
    same_s: float


class RunRecorder:
    """Records a run inside its `with` block: samples the robots and listens to the run.

    Args:
        directory: the run's folder, which must exist. The record of an interrupted run is appended to; call
            `repair_record` first. Without the mcap library, which is logged, there is no `run.mcap`.
        past: the record of a past that is repeated; poses only.

    Raises:
        OSError: the file cannot be created.
    """

    def __init__(
        self,
        fleet: Fleet,
        robots: Iterable[str],
        directory: Path,
        extent: Extent = "poses",
        past: RepeatedPast | None = None,
    ) -> None:
        self._fleet = fleet
        self._clock = fleet.clock
        self._lock = threading.Lock()
        self._start_s: float | None = None
        self._first_s = 0.0
        self._early: dict[str, Callable[[float], None]] = {}
        self._infos = resource_infos(fleet, robots)
        self._angles: Mapping[str, list[float]] = {}
        self._directory = directory
        self._table: TrajectoryTable | None = TrajectoryTable(directory / TRAJECTORY)
        self._newest_s: dict[str, float] = {}
        self._faulty: set[str] = set()  # topics of images that could not be encoded
        self._specs = tuple(self._specs_of(extent))
        self._past = past
        from_s = -math.inf if past is None else past.start_s + past.until_s - POSE_PERIOD_S / 2
        self._sampler = Sampler(fleet.clock, self._specs, self._add, from_s)
        self._file = _new_file(directory, past)

    def __enter__(self) -> Self:
        if self._past is not None:
            self._copy(self._past)
        if self._file is not None:
            self._guarded(self._open)
            self._angles = scanner_angles(self._infos, self._specs)
        if self._fleet.config.rate == MAX:  # other runs do not repeat
            past = dict(self._findings(self._past)) if self._past is not None else None
            self._fleet.services.picture_log = PictureLog(self._add_findings, past)
        self._sampler.__enter__()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._sampler.__exit__(*exc_info)
        self._fleet.services.picture_log = None
        with self._lock:  # a tracker may still report a picture
            self._guarded(McapFile.close)
            self._file = None
        try:
            if self._table is not None:
                self._table.close()
            record = self._directory / RECORD_FILE
            if (self._directory / PART_FILE).exists() or (record.exists() and not is_whole(record)):
                merge_record(RunFolder.open(self._directory))
        except (OSError, EALError) as error:
            get_logger().error("the run's record is incomplete", reason=str(error))

    def _specs_of(self, extent: Extent) -> Iterable[SampleSpec]:
        for robot, infos in self._infos.items():
            for name, info in infos.items():
                resource = self._fleet[robot][name]
                if name in POSE_RESOURCES:
                    yield SampleSpec(resource, POSE_PERIOD_S)
                elif extent == "poses" or info.value is None or ResourceType.SENSOR not in info.types:
                    continue
                elif not info.is_camera:
                    yield SampleSpec(resource, SENSOR_PERIOD_S)
                elif extent == "all":
                    yield SampleSpec(resource, FRAME_PERIOD_S)

    def _open(self, file: McapFile) -> None:
        config = self._fleet.config
        file.add_metadata(RUN, {"fleet": config.name, "seed": str(config.seed)})
        infos = {robot: {name: info.to_dict() for name, info in found.items()} for robot, found in self._infos.items()}
        file.attach(INFOS, infos)
        file.flush()
        if config.world is not None:
            file.write(mcap_file.ARENA_TOPIC, schemas.SCENE, 0.0, messages.scene_message(config.world))
        if radii_m := hull_radii_m(self._fleet, self._infos):
            file.write(mcap_file.HULLS_TOPIC, schemas.SCENE, 0.0, messages.hull_message(radii_m))

    def _copy(self, past: RepeatedPast) -> None:
        """Copy the samples of a repeated past; the file begins with them, and so has the start of the other run."""

        def is_past(time_s: float) -> bool:
            return round(time_s, 3) < past.until_s  # as in the table

        for robot, path in past.run.paths.items():
            name = path_resource(self._infos.get(robot, ()))
            for sample in path:
                if name is not None and self._table is not None and is_past(sample.time_s):
                    self._table.add(robot, sample)
                    self._newest_s[pose_topic(robot, name)] = sample.time_s + ROUNDING_S
        topics = {topic_of(spec.resource) for spec in self._specs}
        topics |= {mcap_file.TRANSFORMS_TOPIC, mcap_file.FINDINGS_TOPIC}

        def is_wanted(stored: StoredMessage) -> bool:
            return stored.topic in topics and is_past(stored.time_s)

        file = past.run.path / RECORD_FILE
        if self._file is not None and file.exists():
            ours = self._file
            self._guarded(lambda _: ours.copy(file, is_wanted))
            self._newest_s.update({topic: time_s + ROUNDING_S for topic, time_s in ours.newest_s.items()})

    @staticmethod
    def _findings(past: RepeatedPast) -> Iterator[tuple[tuple[str, float], Findings]]:
        """Yield what was found in the pictures of a repeated past."""
        file = past.run.path / RECORD_FILE
        for camera, stamp_s, found in mcap_file.read_findings(file) if file.exists() else ():
            if stamp_s < past.start_s + past.same_s - ROUNDING_S:
                yield (camera, stamp_s), found

    def _add_findings(self, camera: str, stamp_s: float, found: Findings) -> None:
        """Write what a tracker found in a picture. Thread: the tracker's."""
        with self._lock:
            if self._start_s is None:
                return
            time_s = stamp_s - self._start_s
            if self._past is None or round(time_s, 3) >= self._past.until_s:  # the others were copied
                self._guarded(lambda file: mcap_file.write_findings(file, time_s, camera, stamp_s, found))

    # Samples. Thread: the sampler's.

    def _add(self, resource: ResourceHandle, data: EALData) -> bool:
        stamp_s = data.stamp_s if data.stamp_s is not None else self._clock.now()
        if resource.name in POSE_RESOURCES:
            sample = pose_sample(resource, data, self._clock)
            if sample is None:
                return False
            write = partial(self._write_pose, resource, sample)
        else:
            write = partial(self._write_value, resource, data)
        with self._lock:
            if self._start_s is None:  # the last value before the start becomes the first one
                self._early[topic_of(resource)] = write
            else:
                write(self._run_s(stamp_s))
        return True

    def _write_pose(self, resource: ResourceHandle, sample: PoseSample, time_s: float) -> None:
        robot, name, topic = resource.robot, resource.name, topic_of(resource)
        if time_s <= self._newest_s.get(topic, -1.0):
            return
        self._newest_s[topic] = time_s
        sample = sample._replace(time_s=time_s)
        if name != path_resource(self._infos[robot]):
            self._guarded(lambda file: file.write_all(mcap_file.pose_messages(robot, name, sample)))
            return
        self._guarded(lambda file: file.write_all(mcap_file.path_messages(robot, name, sample)))
        try:
            if self._table is not None:
                self._table.add(robot, sample)
        except OSError as error:
            get_logger().error("trajectory.csv ends here", reason=str(error))
            self._table = None

    def _write_value(self, resource: ResourceHandle, data: EALData, time_s: float) -> None:
        topic = topic_of(resource)
        try:
            schema, message = message_of(resource, data, time_s, self._angles.get(topic))
        except EALError as error:
            if topic not in self._faulty:  # else a camera of empty images fills the log
                self._faulty.add(topic)
                get_logger().warning("an image is not recorded", topic=topic, reason=error.message)
            return
        self._guarded(lambda file: file.write(topic, schema, time_s, message))

    # Events. Thread: the run's.

    def hear(self, event: RunEvent) -> None:
        """Record an event of the run; the first one has the time of its start."""
        with self._lock:
            if isinstance(event, RunStarted | RunContinued) and self._start_s is None:
                self._start_s = self._clock.now() - event.time_s
                self._first_s = event.time_s if isinstance(event, RunContinued) else 0.0
                for write in self._early.values():
                    write(self._first_s)
                self._early.clear()
            fields = event.to_dict()
            self._guarded(lambda file: file.write_all(mcap_file.event_messages(fields)))
            if isinstance(event, StepEnded) and isinstance(event.answer, EALData):
                self._write_answer(event.record, event.answer)

    def _write_answer(self, record: StepRecord, answer: EALData) -> None:
        """Write a value that the scenario read from a sensor, in any extent; poses are sampled anyway."""
        robot, name = record.robot or "", record.resource or ""
        if record.kind == "get_value" and name not in POSE_RESOURCES and name in self._infos.get(robot, {}):
            stamp_s = self._run_s(answer.stamp_s) if answer.stamp_s is not None else record.end_s
            self._write_value(self._fleet[robot][name], answer, stamp_s)

    def _run_s(self, clock_s: float) -> float:
        """Return a time of the fleet's clock in seconds since the run's start, at least the time of its resumption."""
        return max(self._first_s, clock_s - (self._start_s or 0.0))

    def _guarded(self, write: Callable[[McapFile], object]) -> None:
        """Write, unless an earlier write failed: a full disk must not end the run."""
        if self._file is None:
            return
        try:
            write(self._file)
        except OSError as error:
            get_logger().error("run.mcap ends here", reason=str(error))
            self._file.abandon()
            self._file = None


def _new_file(directory: Path, past: RepeatedPast | None) -> McapFile | None:
    path = directory / RECORD_FILE
    has_start = past is not None and (past.run.path / RECORD_FILE).exists()
    try:
        return McapFile(path if not path.exists() else directory / PART_FILE, None if has_start else wall_time())
    except UnsupportedError as error:
        get_logger().warning("there will be no run.mcap", reason=error.message)
        return None
