"""The scenario step `compare_views`: what has changed between two pictures that a robot saved."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, Protocol

import cv2
import numpy as np

from eal_actors.kernel.errors import ArgumentError, ScenarioError
from eal_actors.lab.choreography.changes import Changes, Image, find_changes
from eal_actors.scenario.report.files import check_file_name

_RED: Final = (220, 30, 30)


class Context(Protocol):
    """What the step uses of its scenario."""

    @property
    def robot(self) -> str | None:
        """The robot of the `on` around it."""
        ...

    @property
    def directory(self) -> Path | None:
        """The run's folder."""
        ...


def compare_views(context: Context, *, before: str, after: str, save: str) -> dict[str, Any]:
    """Compare two pictures of one place in the robot's folder; stands inside an `on`.

    Args:
        context: of the step.
        before: the name of the earlier picture.
        after: the name of the later one.
        save: the name that a picture of both gets, with what has changed framed; not made if nothing has.

    Returns:
        `things`, how many things have come or gone; `share`, how much of the picture they take, 0 to 1.

    Raises:
        ScenarioError: it stands outside an `on`, nothing is kept of the run, a name leads out of the folder, or the
            pictures are none or do not fit.
    """
    if context.robot is None:
        raise ScenarioError("compare_views is of one robot: it must stand inside an `on`")
    if context.directory is None:
        raise ScenarioError("there are no pictures to compare: the run keeps no files")
    for name in (before, after, save):
        check_file_name(name)
    folder = context.directory / context.robot
    views = [_read(folder / name) for name in (before, after)]
    try:
        changes = find_changes(*views)
    except ArgumentError as error:
        raise ScenarioError(f"{before} and {after} cannot be compared: {error.message}") from None
    if changes.boxes:
        _write(views, changes, folder / save)
    return {"things": len(changes.boxes), "share": changes.share}


def _read(file: Path) -> Image:
    image = cv2.imread(str(file), cv2.IMREAD_COLOR)
    if image is None:
        raise ScenarioError(f"{file} is no picture" if file.exists() else f"{file} is missing")
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)


def _write(views: list[Image], changes: Changes, file: Path) -> None:
    for view in views:
        thickness = max(1, view.shape[1] // 200)
        for x, y, width, height in changes.boxes:
            cv2.rectangle(view, (x, y), (x + width, y + height), _RED, thickness)
    both = cv2.cvtColor(np.hstack(views), cv2.COLOR_RGB2BGR)
    if not cv2.imwrite(str(file), both):
        raise ScenarioError(f"{file} cannot be written")
