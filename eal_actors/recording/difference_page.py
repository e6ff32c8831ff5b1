"""The comparison of two runs as one self-contained HTML page: summary, trails on one map, and differing steps."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any, Final

from eal_actors.device.world import WorldModel
from eal_actors.recording.comparison import compare_runs, first_difference, path_deviations
from eal_actors.recording.picture import draw_trajectory
from eal_actors.recording.report_page import page_template
from eal_actors.recording.run_folder import RunFolder

_TEMPLATE: Final = "difference.html.j2"
_MOST_DIFFERENCES: Final = 200


@dataclass(frozen=True, slots=True)
class ComparedStep:
    """A step of a robot in two runs; a record is None if its run did not perform the step.

    `number` is how often the robot has performed the step, this time included.
    """

    robot: str
    label: str
    step: str
    number: int
    left: Mapping[str, Any] | None
    right: Mapping[str, Any] | None


def render_difference(left: RunFolder, right: RunFolder, world: WorldModel | None = None) -> str:
    """Return the page, whose trails have the world below them if it is given.

    Raises:
        ScenarioError: a folder is broken.
        UnsupportedError: Jinja is not installed.
    """
    return page_template(_TEMPLATE).render(
        runs=[(name, run.path.name, run.summary) for name, run in (("A", left), ("B", right))],
        deviations=path_deviations(left, right),
        first=first_difference(left, right),
        trails=_trails(left, right, world),
        steps=_steps(left, right),
        differences=list(islice(compare_runs(left, right), _MOST_DIFFERENCES)),
    )


def _trails(left: RunFolder, right: RunFolder, world: WorldModel | None) -> str | None:
    paths = {
        f"{robot} {name}": run.paths[robot]
        for robot in dict.fromkeys([*left.paths, *right.paths])
        for name, run in (("A", left), ("B", right))
        if run.paths.get(robot)
    }
    drawn = draw_trajectory(paths, world, io.StringIO()) if paths else None
    svg = drawn.getvalue() if drawn is not None else None
    return svg and svg[svg.index("<svg") :]


def _steps(left: RunFolder, right: RunFolder) -> list[ComparedStep]:
    """Return the steps that differ in their outcome or their times."""
    of_left, of_right = _records(left), _records(right)
    found = []
    for key in dict.fromkeys([*of_left, *of_right]):
        one, other = of_left.get(key), of_right.get(key)
        if one != other:
            robot, step, number = key
            found.append(ComparedStep(robot, (one or other or {})["label"], step, number, one, other))
    return sorted(found, key=lambda row: (row.left or row.right or {})["start_s"])


def _records(run: RunFolder) -> dict[tuple[str, str, int], Mapping[str, Any]]:
    found: dict[tuple[str, str, int], Mapping[str, Any]] = {}
    counts: Counter[tuple[str, str]] = Counter()
    for event in run.events:
        if event["event"] == "step_ended":
            record = event["record"]
            step = record["robot"] or "", record["step"]
            counts[step] += 1
            found[*step, counts[step]] = record
    return found
