"""Repair of an interrupted run's record, and the merge of its parts when the run was resumed."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Final

from eal_actors.kernel.errors import ScenarioError, UnsupportedError
from eal_actors.kernel.log import get_logger
from eal_actors.recording import mcap_file
from eal_actors.recording.mcap_file import RECORD_FILE, McapFile, is_whole, pose_topic
from eal_actors.recording.poses import POSE_RESOURCES, ROUNDING_S, path_resource
from eal_actors.recording.recorded_run import INFOS
from eal_actors.recording.run_folder import TRAJECTORY, RunFolder
from eal_actors.scenario.report.journal import EVENTS, SUMMARY, cut_half_line, hold_record, is_under_way

PART_FILE: Final = "run-2.mcap"
"""The file of a resumed run until its end, when it is merged into RECORD_FILE."""
_MS: Final = 1000


def repair_record(directory: Path) -> float:
    """Repair the record of an interrupted run: nothing that reached the disk is lost.

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

    The lost end of a part is restored from `events.jsonl` and `trajectory.csv`, which lose nothing.

    Raises:
        UnsupportedError: the mcap library is not installed.
        ScenarioError: a file is broken.
        OSError: a file cannot be written.
    """
    parts = [run.path / RECORD_FILE, run.path / PART_FILE]
    unfinished = run.path / f"{RECORD_FILE}.tmp"
    with ExitStack() as stack:
        unfinished.unlink(missing_ok=True)  # a link would lead elsewhere
        stack.callback(unfinished.unlink, missing_ok=True)
        file = McapFile(unfinished)
        stack.callback(file.close)
        for part in parts:
            if part.exists():
                file.copy(part, partial(_is_new, dict(file.newest_s)))
        _restore_lost(file, run)
        file.close()
        with unfinished.open("rb") as stream:
            os.fsync(stream.fileno())
        unfinished.replace(parts[0])
    parts[1].unlink(missing_ok=True)
    return max(file.newest_s.values(), default=0.0)


def _is_new(newest_s: Mapping[str, float], topic: str, time_s: float) -> bool:
    """Return whether a message is later than those of the part before; else a crash before its removal merged it."""
    return time_s > newest_s.get(topic, -1.0)


def _restore_lost(file: McapFile, run: RunFolder) -> None:
    for event in run.events[file.counts.get(mcap_file.EVENTS_TOPIC, 0) :]:
        mcap_file.write_event(file, event)
    for robot, path in run.paths.items():
        resource = path_resource(file.attached.get(INFOS, {}).get(robot, ())) or POSE_RESOURCES[-1]
        last_s = file.newest_s.get(pose_topic(robot, resource), -1.0) + ROUNDING_S
        for sample in path:
            if sample.time_s > last_s:
                mcap_file.write_path(file, robot, resource, sample)
