"""What a run leaves in `run.mcap`: poses, and events with the calls and the words that they tell of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from eal_actors.recording import messages, schemas
from eal_actors.recording.mcap_file import McapFile
from eal_actors.recording.notes import note_of
from eal_actors.recording.pose_sample import PoseSample
from eal_actors.recording.poses import POSE_RESOURCE

EVENTS_TOPIC: Final = "/events"
ARENA_TOPIC: Final = "/arena"


def pose_topic(robot: str) -> str:
    """Return where a robot's poses are written to."""
    return f"/{robot}/{POSE_RESOURCE}"


def write_pose(file: McapFile, robot: str, sample: PoseSample) -> None:
    """Write where a robot is, once for programs and once as the transform that viewers hang everything else on.

    Raises:
        OSError: it cannot be written.
    """
    file.write(pose_topic(robot), schemas.POSE, sample.time_s, messages.pose_message(sample))
    file.write("/tf", schemas.TRANSFORMS, sample.time_s, messages.transform_message(robot, sample))


def write_event(file: McapFile, event: Mapping[str, Any]) -> None:
    """Write an event as `events.jsonl` has it, the call that it ends, and what people should read of it.

    Raises:
        OSError: it cannot be written.
    """
    time_s = event["time_s"]
    file.write(EVENTS_TOPIC, schemas.EVENT, time_s, {**messages.stamped(time_s), **event})
    if event["event"] == "step_ended" and event["record"]["resource"] is not None:
        record = event["record"]
        file.write(f"/{record['robot']}/commands", schemas.COMMAND, record["end_s"], _command_message(record))
    if (note := note_of(event)) is not None:
        log = messages.log_message(note.time_s, note.level, note.whose, note.text)
        file.write("/log", schemas.LOG, note.time_s, log)


def _command_message(record: Mapping[str, Any]) -> messages.Message:
    return {
        **messages.stamped(record["start_s"]),
        "resource": record["resource"],
        "method": record["kind"],
        "command": record["command"] or "",
        "step": record["step"],
        "outcome": record["outcome"],
        "duration_s": record["end_s"] - record["start_s"],
        "error": record["error"]["message"] if record["error"] is not None else "",
    }
