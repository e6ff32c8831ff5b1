"""The scenario step `compare_views`: find changes between two pictures that a robot saved."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from eal_actors.kernel.errors import ArgumentError, ScenarioError
from eal_actors.lab.changes.detection import Changes, Image, find_changes
from eal_actors.scenario.report.files import check_file_name
from eal_actors.scenario.steps.python import StepContext

_RED: Final = (220, 30, 30)


def compare_views(context: StepContext, *, before: str, after: str, save: str) -> dict[str, Any]:
    """Compare two pictures of one place in the robot's folder, and log a change; the step belongs inside an `on`.

    Args:
        context: of the step.
        before: file name of the earlier picture. With one `*` in place of a number that `after` has there, it is the
            last picture before that; where there is none, nothing has changed.
        after: file name of the later picture.
        save: file name of a picture of both with boxes round the changes; written only if there are changes.

    Returns:
        `things`, the number of objects that appeared or disappeared; `share`, their share of the picture, 0 to 1.

    Raises:
        ScenarioError: the step is outside an `on`, the run keeps no files, a name leads out of the folder, or a picture
            is missing, unreadable or of another shape; or `after` is none of the pictures that `before` stands for.
    """
    if context.robot is None:
        raise ScenarioError("compare_views works on one robot: put it inside an `on`")
    if context.directory is None:
        raise ScenarioError("there are no pictures to compare: the run keeps no files")
    for name in (before, after, save):
        check_file_name(name)
    folder = context.directory / context.robot
    if "*" in before:
        found = _last_before(folder, before, after)
        if found is None:
            return {"things": 0, "share": 0.0}
        before = found
    views = [_read_picture(folder / name) for name in (before, after)]
    try:
        changes = find_changes(*views)
    except ArgumentError as error:
        raise ScenarioError(f"{before} and {after} cannot be compared: {error.message}") from None
    if changes.boxes:
        _write_comparison(views, changes, folder / save)
        context.log(f"{after} is not as {before}: see {save}")
    return {"things": len(changes.boxes), "share": changes.share}


def _last_before(folder: Path, pattern: str, after: str) -> str | None:
    """Return the name with the greatest number below that of `after`, or None."""
    numbered = re.compile(r"(\d+)".join(re.escape(part) for part in pattern.split("*", 1)))
    if (own := numbered.fullmatch(after)) is None:
        raise ScenarioError(f"{after} must be {pattern} with a number in place of one *")
    found = [match for file in folder.glob(pattern) if (match := numbered.fullmatch(str(file.relative_to(folder))))]
    earlier = [match for match in found if int(match[1]) < int(own[1])]
    return max(earlier, key=lambda match: int(match[1]))[0] if earlier else None


def _read_picture(file: Path) -> Image:
    image = cv2.imread(str(file), cv2.IMREAD_COLOR)
    if image is None:
        raise ScenarioError(f"{file} is not a picture" if file.exists() else f"{file} is missing")
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)


def _write_comparison(views: list[Image], changes: Changes, file: Path) -> None:
    for view in views:
        thickness = max(1, view.shape[1] // 200)
        for x, y, width, height in changes.boxes:
            cv2.rectangle(view, (x, y), (x + width, y + height), _RED, thickness)
    both = cv2.cvtColor(np.hstack(views), cv2.COLOR_RGB2BGR)
    if not cv2.imwrite(str(file), both):
        raise ScenarioError(f"{file} cannot be written")


compare_views.safe_to_repeat = True  # type: ignore[attr-defined]  # it reads pictures and writes one
