"""Examination of an agent's scenario: the checks without a fleet, the dry run on the fleet, and the rehearsal.

The rehearsal is a process of its own, `eal rehearse`: its simulation must not delay the process that controls robots,
and an endless scenario must end.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import BusyError, ConfigError, DeadlineError, Problem, ScenarioError, file_error
from eal_actors.kernel.strict_model import model_of
from eal_actors.kernel.yaml_source import LARGE, parse_yaml
from eal_actors.scenario import Plan, Scenario, Timeline, TimelineEntry, make_plan, parse_scenario
from eal_actors.scenario.language.scenario import ScenarioFile

MAX_TEXT: Final = 64 * 1024
"""Characters of a plan."""
SEEDS: Final = 2
"""Rehearsals of a plan, with seeds counted from the fleet's."""
_FILE: Final = "plan.yaml"
_MAX_LINES: Final = 2000


def read_plan(text: str, parameters: Mapping[str, object]) -> Scenario:
    """Return the scenario of a plan.

    Raises ConfigError with its problems. A plan is one file: a person who approves it must see all of it.
    """
    if any("\ud800" <= one <= "\udfff" for one in json.dumps(dict(parameters), ensure_ascii=False)):
        raise ConfigError([Problem(_FILE, 1, 1, "parameters", "one has half a character (a surrogate)")])
    if len(text) > MAX_TEXT:
        raise file_error(_FILE, f"has {len(text)} characters; at most {MAX_TEXT}")
    tree = parse_yaml(text, _FILE, limits=LARGE)
    file = model_of(ScenarioFile, tree)
    if foreign := [(*path, step.kind) for path, step in file.walk() if step.part_file is not None]:
        why = "a plan is one file: write the steps of the other scenario into it"
        raise ConfigError([tree.problem(path, why, key=True) for path in foreign])
    return parse_scenario(text, _FILE, parameters)


def dry_run(scenario: Scenario, fleet: Fleet) -> tuple[Plan, tuple[str, ...]]:
    """Check every call on the robots of a fleet; return the plan and its lines. Nothing moves.

    Raises:
        ConfigError: what the fleet cannot do.
        RobotFailedError: a robot did not start.
    """
    plan = make_plan(scenario, fleet)
    timeline = Timeline.of(scenario, plan.roles)
    lines = [line for entry in (*timeline.steps, *timeline.ending) for line in _lines(entry, "")]
    more = [f"and {len(lines) - _MAX_LINES} more"] if len(lines) > _MAX_LINES else []
    return plan, (*lines[:_MAX_LINES], *more)


def _lines(entry: TimelineEntry, indent: str) -> Iterator[str]:
    robots = f": {', '.join(entry.robots)}" if entry.kind == "on" else ""
    yield f"{indent}{entry.text}{robots}"
    for inner in entry.inner:
        yield from _lines(inner, indent + "  ")


@dataclass(frozen=True, slots=True)
class RehearsalResult:
    """The result of the rehearsals of a plan.

    Attributes:
        summary: the JSON of `eal rehearse`.
        duration_s: the longest, in seconds of the fleet's clock.
        problem: why the plan cannot run; None if all ended and no robot touched anything.
    """

    summary: dict[str, Any]
    duration_s: float
    problem: str | None


class Rehearser:
    """Rehearses plans on simulated twins, one at a time. A rehearsal is ended after `limit_s` real seconds.

    Thread: any; `rehearse` blocks its caller for at most `limit_s`.
    """

    def __init__(self, fleet_file: Path, limit_s: float) -> None:
        self._fleet_file = fleet_file
        self._limit_s = limit_s
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._is_closed = False

    def close(self) -> None:
        """End the rehearsal that runs, and let no other run. Thread: any; does not block."""
        self._is_closed = True
        if (process := self._process) is not None:
            process.kill()

    def rehearse(self, text: str, parameters: Mapping[str, object]) -> RehearsalResult:
        """Rehearse a plan that has no problems.

        Raises:
            BusyError: another rehearsal runs.
            DeadlineError: it took too long.
            ScenarioError: it could not be rehearsed.
        """
        if not self._lock.acquire(blocking=False):
            raise BusyError("another plan is being rehearsed; try again after it")
        try:
            with TemporaryDirectory(prefix="eal-plan-") as folder:
                file = Path(folder) / _FILE
                file.write_text(text, encoding="utf-8")
                summary = self._run(file, parameters)
        finally:
            self._lock.release()
        problems = [problem for run in summary["runs"] if (problem := _problem_of(run)) is not None]
        longest_s = max((run["duration_s"] for run in summary["runs"]), default=0.0)
        return RehearsalResult(summary, longest_s, problems[0] if problems else None)

    def _run(self, file: Path, parameters: Mapping[str, object]) -> dict[str, Any]:
        fleet = str(self._fleet_file.resolve())
        settings = [f"--set={name}={json.dumps(value, ensure_ascii=False)}" for name, value in parameters.items()]
        command = [sys.executable, "-P", "-m", "eal_actors", "rehearse", str(file), "--fleet", fleet, "--json"]
        with subprocess.Popen(  # noqa: S603  # our own program; values of parameters are single arguments
            [*command, f"--seeds={SEEDS}", *settings],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            self._process = process
            if self._is_closed:
                process.kill()
            try:
                answer, said = process.communicate(timeout=self._limit_s)
            except subprocess.TimeoutExpired:
                why = f"{_FILE}:1:1: the rehearsal did not end within {self._limit_s:g} s; shorten the plan"
                raise DeadlineError(why) from None
            finally:
                process.kill()
                self._process = None
        try:
            found: dict[str, Any] = json.loads(answer)
        except ValueError:
            raise ScenarioError(f"the plan cannot be rehearsed: {said.strip()[-500:]}") from None
        if "error" in found:
            raise ScenarioError(f"{_FILE}:1:1: the plan cannot be rehearsed: {found['error']['message']}")
        return found


def _problem_of(run: dict[str, Any]) -> str | None:
    """Return why a rehearsed run refuses its plan, with the position of the step."""
    hits = [incident for incident in run["incidents"] if incident["is_hit"]]
    if run["outcome"] != "done":
        steps = run["failed_steps"]
        what = f"{run['outcome']}: {run['error']['message'] if run['error'] else 'a step failed'}"
    elif hits:
        steps = hits[0]["steps"]
        what = f"{hits[0]['robot']} hits {hits[0]['other']} at {hits[0]['time_s']:.2f} s"
    else:
        return None
    line, column = (steps[0]["line"], steps[0]["column"]) if steps else (1, 1)
    return f"{_FILE}:{line}:{column}: rehearsal with seed {run['seed']}: {what}"
