"""`run.mcap` read back as the values and calls of its robots, for the replay."""

from __future__ import annotations

import base64
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import Any, Final, NamedTuple

from eal_actors.device.data import DataType, EALData
from eal_actors.device.info import ResourceInfo
from eal_actors.kernel.errors import ScenarioError, UnsupportedError, error_text
from eal_actors.recording import schemas
from eal_actors.recording.mcap_file import McapContent, RecordedMessage, read_mcap
from eal_actors.recording.messages import ranges_of, seconds, yaw_of
from eal_actors.scenario.report.records import numbers_again

INFOS: Final = "resources.json"
"""The attachment with the ResourceInfo of each robot's resources."""


class RecordedCall(NamedTuple):
    """A completed call; its times are seconds since the run's start."""

    start_s: float
    end_s: float
    method: str
    command: str
    error: str


@dataclass(frozen=True)
class RecordedRun:
    """The values and calls of a record, by robot and resource."""

    content: McapContent

    @classmethod
    def open(cls, path: Path) -> RecordedRun:
        """Read a record.

        Raises:
            UnsupportedError: the mcap library is not installed.
            ScenarioError: it is no record of a run.
            OSError: it cannot be read.
        """
        content = read_mcap(path)
        if INFOS not in content.attachments:
            raise ScenarioError(f"{path} is no record of a run: it does not list the robots' resources")
        return cls(content)

    @cached_property
    def infos(self) -> Mapping[str, Mapping[str, ResourceInfo]]:
        """The ResourceInfo of each robot's resources, by name; raise ScenarioError if they are invalid."""
        try:
            return {
                robot: {name: ResourceInfo.from_dict(fields) for name, fields in infos.items()}
                for robot, infos in self.content.attachments[INFOS].items()
            }
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ScenarioError(f"the record's {INFOS} is invalid: {error_text(error)}") from error

    @cached_property
    def duration_s(self) -> float:
        """Seconds from the run's start to the last message."""
        return max((entry.time_s for entry in self.content.messages), default=0.0)

    def has(self, robot: str, resource: str) -> bool:
        """Return whether anything of a resource was recorded: a value or a call."""
        return self.has_values(robot, resource) or bool(self.calls(robot, resource))

    def has_values(self, robot: str, resource: str) -> bool:
        """Return whether any value of a resource was recorded."""
        return f"/{robot}/{resource}" in self._by_topic

    def value_at(self, robot: str, resource: str, time_s: float) -> EALData | None:
        """Return the last value of a resource at a time, with its stamp; None if it had none yet.

        Raises:
            ScenarioError: the value is invalid.
            UnsupportedError: it is an image, and OpenCV is not installed.
        """
        values = self._by_topic.get(f"/{robot}/{resource}", ())
        index = bisect_right(values, time_s, key=attrgetter("time_s"))
        return _value_of(values[index - 1]) if index else None

    def calls(self, robot: str, resource: str) -> list[RecordedCall]:
        """Return the calls of a resource, in the order of their begins."""
        found = [
            RecordedCall(
                seconds(entry.message), entry.time_s, *(entry.message[key] for key in RecordedCall._fields[2:])
            )
            for entry in self._by_topic.get(f"/{robot}/commands", ())
            if entry.schema == schemas.COMMAND.name and entry.message["resource"] == resource
        ]
        return sorted(found, key=attrgetter("start_s", "end_s"))

    @cached_property
    def _by_topic(self) -> Mapping[str, Sequence[RecordedMessage]]:
        topics: dict[str, list[RecordedMessage]] = {}
        for entry in self.content.messages:
            topics.setdefault(entry.topic, []).append(entry)
        for entries in topics.values():
            entries.sort(key=attrgetter("time_s"))
        return topics


def _value_of(entry: RecordedMessage) -> EALData:
    message, stamp_s = entry.message, entry.time_s
    try:
        match entry.schema:
            case schemas.POSE.name:
                at, turn = message["pose"]["position"], message["pose"]["orientation"]
                return EALData.of([at["x"], at["y"], yaw_of(turn)], stamp_s=stamp_s)
            case schemas.SCAN.name:
                return EALData.of(ranges_of(message), unit="m", frame_id=message["frame_id"], stamp_s=stamp_s)
            case schemas.IMAGE.name:
                return EALData.of(_image(message["data"]), frame_id=message["frame_id"], stamp_s=stamp_s)
            case schemas.VALUE.name:
                return _generic_value(message, stamp_s)
    except (KeyError, TypeError, ValueError) as error:
        raise ScenarioError(f"the record's value at {stamp_s:.3f} s is invalid: {error_text(error)}") from error
    raise ScenarioError(f"the record has a message of schema {entry.schema} in place of a value")


def _generic_value(message: Mapping[str, Any], stamp_s: float) -> EALData:
    dtype, kind = message["dtype"], DataType(message["type"])
    value = message["value"] if kind in (DataType.CHAR, DataType.VOID) else numbers_again(message["value"])
    meta: dict[str, Any] = {
        "unit": message["unit"] or None,
        "frame_id": message["frame_id"] or None,
        "stamp_s": stamp_s,
    }
    if dtype:
        import numpy as np

        return EALData.of(np.array(value, dtype).reshape(message["shape"]), **meta)
    if kind is DataType.VOID:
        value = base64.b64decode(value)
    modifiers: dict[str, Any] = dict.fromkeys(message["modifiers"], True)
    return EALData(kind, value, **modifiers, **meta)


def _image(data: str) -> Any:
    try:
        import cv2
        import numpy as np
    except ImportError as error:
        raise UnsupportedError("frames of a record need OpenCV: pip install 'eal-actors[vision]'") from error
    file = np.frombuffer(base64.b64decode(data), np.uint8)
    image = cv2.imdecode(file, cv2.IMREAD_COLOR_RGB) if file.size else None
    if image is None:
        raise ValueError("a frame is no image")
    return image
