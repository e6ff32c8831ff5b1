"""The Python step `stitch_panorama`: at the end of a scenario, each robot's frames become its panorama."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, Protocol

from eal_actors.kernel.errors import ArgumentError, ScenarioError
from eal_actors.lab.panorama.folder import PANORAMA, describe, read_shots, save_panorama
from eal_actors.lab.panorama.stitching import stitch

_REPORT: Final = "panorama.json"


class Context(Protocol):
    """What the step needs of the run that it is a step of."""

    @property
    def robots(self) -> Mapping[str, Any]:
        """The robots that take part, by name."""

    @property
    def directory(self) -> Path | None:
        """The run's folder, in which each robot has one for what it saved; None if nothing is kept."""

    @property
    def is_cancelled(self) -> Callable[[], bool]:
        """Tells whether the run is being ended."""

    @property
    def log(self) -> Callable[[str], None]:
        """Tells those who watch."""


def stitch_run(context: Context, field_of_view_deg: float = 60.0, step_deg: float | None = None) -> dict[str, Any]:
    """Stitch what each robot of a run saved into `panorama.png`, with `panorama.json` beside it.

    Args:
        context: the run. Robots without pictures are passed over.
        field_of_view_deg: angle between the left and the right edge of a frame.
        step_deg: how far a robot turned right from each frame to the next; what stands beside the frames if left out.

    Returns:
        For each robot what `panorama.json` says.

    Raises:
        ScenarioError: there is nothing to stitch, or a frame could not be placed; every robot's panorama that could be
            made has been kept.

    Thread: any that may be blocked for seconds.
    """
    if context.directory is None:
        raise ScenarioError("there are no frames to stitch: the run keeps no files")
    reports: dict[str, Any] = {}
    problems: list[str] = []
    for name in sorted(context.robots):
        if context.is_cancelled():
            break
        folder = context.directory / name
        if folder.is_dir() and any(folder.glob("*.png")):
            try:
                reports[name] = _stitch_folder(folder, field_of_view_deg, step_deg)
            except (ArgumentError, ValueError) as error:  # ConfigError is a ValueError
                problems.append(f"{name}: {error}")
            else:
                left_out = _left_out(reports[name])
                number = len(reports[name]["frames"])
                context.log(f"{name}: {number - len(left_out)} of {number} frames stitched into {PANORAMA}")
                problems += [f"{name}: {said}" for said in left_out]
    if problems:
        raise ScenarioError("\n".join(problems))
    if not reports and not context.is_cancelled():
        raise ScenarioError("there are no frames to stitch: no robot has saved pictures")
    return reports


def _stitch_folder(folder: Path, field_of_view_deg: float, step_deg: float | None) -> dict[str, Any]:
    shots = read_shots(folder, None if step_deg is None else math.radians(step_deg))
    panorama = stitch(shots.frames, shots.yaws_rad, math.radians(field_of_view_deg), names=shots.names)
    save_panorama(panorama, folder / PANORAMA)
    report = describe(panorama, shots)
    (folder / _REPORT).write_text(json.dumps(report, indent=2), encoding="utf-8")
    return report


def _left_out(report: Mapping[str, Any]) -> list[str]:
    return [f"{frame['file']} {frame['left_out']}" for frame in report["frames"] if frame["left_out"]]
