"""A record read back as what robots said and did, for those who play it again."""

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
from eal_actors.recording.mcap_file import Entry, McapContent, read_mcap
from eal_actors.recording.messages import ranges_of, seconds, yaw_of
from eal_actors.scenario.strict_json import numbers_again

INFOS: Final = "resources.json"
"""The attachment in which the robots' resources describe themselves."""


class RecordedCall(NamedTuple):
    """A call that is over, in seconds since the run's start."""

    start_s: float
    end_s: float
    method: str
    command: str
    outcome: str
    error: str


@dataclass(frozen=True)
class RecordedRun:
    """What a record holds, by robot and resource.

    Attributes:
        content: the file.
    """

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
            raise ScenarioError(f"{path} is no record of a run: it does not say which resources the robots have")
        return cls(content)

    @cached_property
    def infos(self) -> Mapping[str, Mapping[str, ResourceInfo]]:
        """What the resources of each robot said of themselves.

        Raises:
            ScenarioError: it cannot be understood.
        """
        try:
            return {
                robot: {name: ResourceInfo.from_dict(fields) for name, fields in infos.items()}
                for robot, infos in self.content.attachments[INFOS].items()
            }
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ScenarioError(f"the record's {INFOS} cannot be understood: {error_text(error)}") from error

    @cached_property
    def duration_s(self) -> float:
        """From the run's start to the last message."""
        return max((entry.time_s for entry in self.content.entries), default=0.0)

    def has(self, robot: str, resource: str) -> bool:
        """Return whether anything of a resource was recorded: a value or a call."""
        return self.has_values(robot, resource) or bool(self.calls(robot, resource))

    def has_values(self, robot: str, resource: str) -> bool:
        """Return whether any value of a resource was recorded."""
        return f"/{robot}/{resource}" in self._by_topic

    def value_at(self, robot: str, resource: str, time_s: float) -> EALData | None:
        """Return what a resource said last at a time, stamped with when; None if it had said nothing yet.

        Raises:
            ScenarioError: what it said cannot be understood.
            UnsupportedError: it is a picture, and OpenCV is not installed.
        """
        said = self._by_topic.get(f"/{robot}/{resource}", ())
        index = bisect_right(said, time_s, key=attrgetter("time_s"))
        return _value_of(said[index - 1]) if index else None

    def calls(self, robot: str, resource: str) -> list[RecordedCall]:
        """Return the calls of a resource, in the order in which they began."""
        found = [
            RecordedCall(
                seconds(entry.message),
                entry.time_s,
                entry.message["method"],
                entry.message["command"],
                entry.message["outcome"],
                entry.message["error"],
            )
            for entry in self._by_topic.get(f"/{robot}/commands", ())
            if entry.schema == schemas.COMMAND.name and entry.message["resource"] == resource
        ]
        return sorted(found, key=attrgetter("start_s", "end_s"))

    @cached_property
    def _by_topic(self) -> Mapping[str, Sequence[Entry]]:
        topics: dict[str, list[Entry]] = {}
        for entry in self.content.entries:
            topics.setdefault(entry.topic, []).append(entry)
        for entries in topics.values():
            entries.sort(key=attrgetter("time_s"))
        return topics


def _value_of(entry: Entry) -> EALData:
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
                return _plain_value(message, stamp_s)
    except (KeyError, TypeError, ValueError) as error:
        raise ScenarioError(
            f"what the record has at {stamp_s:.3f} s cannot be understood: {error_text(error)}"
        ) from error
    raise ScenarioError(f"the record has a message of the schema {entry.schema} in place of a value")


def _plain_value(message: Mapping[str, Any], stamp_s: float) -> EALData:
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
    image = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR_RGB)
    if image is None:
        raise ValueError("a frame is no image")
    return image
