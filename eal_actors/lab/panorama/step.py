"""The scenario step `stitch_panorama`: stitch the frames that each robot saved into its panorama."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Final

from eal_actors.kernel.errors import ArgumentError, ScenarioError
from eal_actors.lab.panorama.folder import PANORAMA, describe, read_frames, save_panorama
from eal_actors.lab.panorama.stitching import check_frames, stitch
from eal_actors.scenario.steps.python import StepContext

_REPORT: Final = "panorama.json"


def stitch_run(context: StepContext, field_of_view_deg: float = 60.0, step_deg: float | None = None) -> dict[str, Any]:
    """Stitch the pictures of each robot of a run into `panorama.png`, with a report in `panorama.json`.

    Args:
        context: of the step. Robots without pictures are skipped. If the run's files are thrown away, the frames are
            only checked: whether they can be read, and overlap.
        field_of_view_deg: angle between the left and right edges of a frame.
        step_deg: turn to the right from each frame to the next; default: from the files beside the frames.

    Returns:
        The content of `panorama.json` for each robot.

    Raises:
        ScenarioError: there is nothing to stitch, or a frame could not be placed; finished panoramas are kept.

    Thread: any that may be blocked for seconds.
    """
    if context.directory is None:
        raise ScenarioError("there are no frames to stitch: the run keeps no files")
    perform = _stitch_folder if context.keeps_files else _check_folder
    reports: dict[str, Any] = {}
    problems: list[str] = []
    for name in sorted(context.robots):
        if context.is_cancelled():
            break
        folder = context.directory / name
        if folder.is_dir() and any(folder.glob("*.png")):
            try:
                reports[name] = perform(folder, field_of_view_deg, step_deg)
            except (ArgumentError, ValueError) as error:  # ConfigError is a ValueError
                problems.append(f"{name}: {error}")
            else:
                frames = reports[name]["frames"]
                left_out = [f"{frame['file']} {frame['left_out']}" for frame in frames if frame["left_out"]]
                number = len(frames)
                context.log(f"{name}: {number - len(left_out)} of {number} frames stitched into {PANORAMA}")
                problems += [f"{name}: {reason}" for reason in left_out]
    if problems:
        raise ScenarioError("\n".join(problems))
    if not reports and not context.is_cancelled():
        raise ScenarioError("there are no frames to stitch: no robot has saved pictures")
    return reports


def _stitch_folder(folder: Path, field_of_view_deg: float, step_deg: float | None) -> dict[str, Any]:
    frames = read_frames(folder, None if step_deg is None else math.radians(step_deg))
    panorama = stitch(frames.images, frames.yaws_rad, math.radians(field_of_view_deg), names=frames.names)
    save_panorama(panorama, folder / PANORAMA)
    report = describe(panorama, frames)
    (folder / _REPORT).write_text(json.dumps(report, indent=2), encoding="utf-8")
    return report


def _check_folder(folder: Path, field_of_view_deg: float, step_deg: float | None) -> dict[str, Any]:
    """Check the frames of a robot; return their part of the report."""
    frames = read_frames(folder, None if step_deg is None else math.radians(step_deg))
    _, odd = check_frames(frames.images, frames.yaws_rad, math.radians(field_of_view_deg), frames.names)
    return {"frames": [{"file": name, "left_out": odd.get(number)} for number, name in enumerate(frames.names)]}


stitch_run.safe_to_repeat = True  # type: ignore[attr-defined]  # it reads pictures and writes one
