"""Repair of an interrupted run's record or a damaged one, and the merge of its parts when the run was resumed."""

from __future__ import annotations

import json
import math
import os
import shutil
import struct
from collections import Counter, defaultdict
from collections.abc import Mapping
from contextlib import ExitStack
from functools import partial
from itertools import count
from pathlib import Path
from typing import Final

from eal_actors.kernel.errors import ScenarioError, UnsupportedError
from eal_actors.kernel.log import get_logger
from eal_actors.recording import mcap_file, schemas
from eal_actors.recording.mcap_file import RECORD_FILE, McapFile, TimedMessage
from eal_actors.recording.mcap_records import Loss, StoredMessage, is_whole
from eal_actors.recording.messages import Message, nanoseconds
from eal_actors.recording.poses import POSE_RESOURCES, path_resource
from eal_actors.recording.recorded_run import INFOS
from eal_actors.recording.run_folder import TRAJECTORY, RunFolder
from eal_actors.scenario.report.journal import EVENTS, SUMMARY, cut_half_line, hold_record, is_under_way
from eal_actors.scenario.report.records import as_json

PART_FILE: Final = "run-2.mcap"
"""The file of a resumed run until its end, when it is merged into RECORD_FILE."""
_MS: Final = 1000


def repair_record(directory: Path) -> float:
    """Repair the record of an interrupted run: nothing that reached the disk is lost, except what is damaged.

    Return the time at which the run is to be resumed, just after the last entry, in seconds since its start.

    Raises:
        ScenarioError: it is no folder of a run, a file in it is broken, or the run is under way.
        OSError: a file cannot be written.
    """
    run = RunFolder.open(directory)
    with hold_record(directory):
        trajectory = run.path / TRAJECTORY
        if trajectory.exists() and not trajectory.is_symlink():
            cut_half_line(trajectory)
        times_s = [float(event["time_s"]) for event in run.events]
        times_s += [path[-1].time_s for path in run.paths.values()]
        try:
            times_s.append(merge_record(run))
        except UnsupportedError as error:
            get_logger().warning("run.mcap ends where the run was interrupted", reason=error.message)
    return (math.ceil(max(times_s, default=0.0) * _MS) + 1) / _MS


def repair_interrupted(runs_dir: Path) -> list[Path]:
    """Repair the records below a folder whose controllers died, so that every reader opens them; return their folders.

    Runs under way are left alone. A record that cannot be repaired is logged.
    """
    repaired = []
    for events in sorted(runs_dir.glob(f"*/{EVENTS}")):
        directory = events.parent
        file = directory / RECORD_FILE
        try:
            if (directory / SUMMARY).exists() or not file.exists() or is_whole(file) or is_under_way(directory):
                continue
            repair_record(directory)
        except (OSError, ScenarioError) as error:
            get_logger().warning(
                "the record of an interrupted run cannot be repaired", run=str(directory), reason=str(error)
            )
        else:
            get_logger().warning("the record of an interrupted run is repaired", run=str(directory))
            repaired.append(directory)
    return repaired


def merge_record(run: RunFolder) -> float:
    """Merge the parts of a record into one `run.mcap`; return the time of the newest message since the run's start.

    What a crash or damage took from a part is restored from `events.jsonl` and `trajectory.csv`, as far as they go.
    What is damaged is logged, and the damaged file is kept beside the new one.

    Raises:
        UnsupportedError: the mcap library is not installed.
        ScenarioError: a file is broken.
        OSError: a file cannot be written.
    """
    parts = [part for name in (RECORD_FILE, PART_FILE) if (part := run.path / name).exists()]
    unfinished = run.path / f"{RECORD_FILE}.tmp"
    with ExitStack() as stack:
        unfinished.unlink(missing_ok=True)  # a link would lead elsewhere
        stack.callback(unfinished.unlink, missing_ok=True)
        file = McapFile(unfinished)
        stack.callback(file.abandon)
        kept = _Kept()
        losses = [file.copy(part, partial(kept.take, dict(file.newest_s)), is_repair=True) for part in parts]
        _restore_lost(file, run, kept)
        file.close()
        with unfinished.open("rb") as stream:
            os.fsync(stream.fileno())
        for part, lost in zip(parts, losses, strict=True):
            if lost is not None:
                _report(part, lost)
        unfinished.replace(run.path / RECORD_FILE)
    (run.path / PART_FILE).unlink(missing_ok=True)
    return max(file.newest_s.values(), default=0.0)


def _report(part: Path, loss: Loss) -> None:
    """Log what is left out of a part of a record; keep a copy of one that is damaged, not only cut off by a crash."""
    until = f"to {loss.until_s:.2f} s" if loss.until_s < math.inf else "on"
    lost = f"{loss.size} bytes, from {loss.from_s:.2f} s {until}" if loss.size else ""
    lost = ", ".join(filter(None, [lost, loss.name]))
    if not loss.reason:
        get_logger().warning("a crash has cut off the end of a record", file=str(part), lost=lost)
        return
    names = (part.with_name(f"{part.name}.damaged{number or ''}") for number in count())
    original = next(name for name in names if not os.path.lexists(name))
    shutil.copyfile(part, original)
    get_logger().warning("damaged parts of a record are left out", lost=lost, original=str(original))


class _Kept:
    """The messages of a record that events.jsonl and trajectory.csv have too. Those that it lacks are restored."""

    def __init__(self) -> None:
        self._texts: Counter[tuple[str, int, str]] = Counter()
        self._times_ms: defaultdict[tuple[str, str], set[int]] = defaultdict(set)

    def take(self, newest_s: Mapping[str, float], stored: StoredMessage) -> bool:
        """Add a message and return True if it is later than those of the part before.

        Else a crash before the removal of its part merged it.
        """
        if stored.time_s <= newest_s.get(stored.topic, -1.0):
            return False
        match stored.schema.name:
            case schemas.POSE.name:
                self._times_ms[stored.topic, ""].add(round(stored.time_s * _MS))
            case schemas.TRANSFORMS.name:
                frames = _frames(json.loads(stored.data))
                self._times_ms[stored.topic, frames].add(round(stored.time_s * _MS))
            case schemas.EVENT.name | schemas.COMMAND.name | schemas.LOG.name:
                text = _text(json.loads(stored.data))
                self._texts[stored.topic, stored.log_ns - stored.start_ns, text] += 1
        return True

    def lacks_text(self, timed: TimedMessage) -> bool:
        """Return whether an event, a call or a log line is to be restored; each counts once."""
        topic, _, time_s, message = timed
        key = topic, nanoseconds(time_s), _text(message)
        self._texts[key] -= 1
        return self._texts[key] < 0

    def lacks_pose(self, timed: TimedMessage) -> bool:
        """Return whether a pose or a transform is to be restored; its time is rounded."""
        topic, _, time_s, message = timed
        times_ms = self._times_ms[topic, _frames(message)]
        return times_ms.isdisjoint(round(time_s * _MS) + apart for apart in (-1, 0, 1))


def _frames(message: Message) -> str:
    """Return whose transforms a message has; nothing for a pose."""
    return ",".join(transform["child_frame_id"] for transform in message.get("transforms", ()))


def _text(message: Message) -> str:
    return as_json({key: value for key, value in message.items() if key != "timestamp"})


def _restore_lost(file: McapFile, run: RunFolder, kept: _Kept) -> None:
    try:
        for event in run.events:
            file.write_all(filter(kept.lacks_text, mcap_file.event_messages(event)))
        for robot, path in run.paths.items():
            has_any = (name for name in POSE_RESOURCES if mcap_file.pose_topic(robot, name) in file.newest_s)
            resource = path_resource(file.attached.get(INFOS, {}).get(robot, ())) or next(has_any, POSE_RESOURCES[-1])
            for sample in path:
                file.write_all(filter(kept.lacks_pose, mcap_file.path_messages(robot, resource, sample)))
    except (OverflowError, struct.error) as error:
        raise ScenarioError(f"{run.path} has a time that no record can have: {error}") from error
