"""What came of the runs of a sweep: a row for each, as a table (CSV) and for tools that show tests (JUnit XML)."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeAlias
from xml.etree import ElementTree as Xml

from eal_actors.lab.sweeping.sweep import Job
from eal_actors.recording import RunFolder
from eal_actors.scenario import Report, Scenario

Scalar: TypeAlias = bool | int | float | str

REFUSED: Final = "refused"
"""The run did not begin: the robots cannot do what it asks with these values."""
CRASHED: Final = "crashed"
"""The process died that carried it out."""
_HELD: Final = {True: "passed", False: "failed", None: ""}


@dataclass(frozen=True, slots=True)
class Result:
    """One row.

    Attributes:
        job: the run.
        outcome: `done`, `failed` or `aborted`; REFUSED or CRASHED where there was no end.
        duration_s: seconds of the fleet's clock; None where there was no end.
        error: what went wrong; empty if nothing did.
        expected: by the path of each `expect` that was reached, whether it held every time.
        variables: numbers, texts and truth values as they stood last: of the run by name, of robots by `robot.name`.
    """

    job: Job
    outcome: str
    duration_s: float | None = None
    error: str = ""
    expected: Mapping[str, bool] = field(default_factory=dict)
    variables: Mapping[str, Scalar] = field(default_factory=dict)

    @property
    def is_good(self) -> bool:
        """Whether it is done, and every expectation held."""
        return self.outcome == "done" and all(self.expected.values())


def read_result(job: Job, folder: RunFolder, scenario: Scenario) -> Result:
    """Return what came of a run that has ended.

    Raises:
        ScenarioError: its record is broken.
    """
    report = folder.summary
    if report is None:
        return Result(job, CRASHED, error="it has no summary")
    error = report.error.message if report.error is not None else ""
    known = set(scenario.expectations())
    expected: dict[str, bool] = {}
    for step in report.steps:
        if step.step in known and step.outcome not in ("aborted", "stopped"):
            expected[step.step] = expected.get(step.step, True) and step.error is None
    return Result(job, report.outcome, report.duration_s, error, expected, _variables(folder, report))


def _variables(folder: RunFolder, report: Report) -> dict[str, Scalar]:
    checkpoint = next((event for event in reversed(folder.events) if event["event"] == "checkpoint"), None)
    if checkpoint is None:
        return {}
    found = dict(checkpoint["variables"])
    for role in report.roles:
        for seat in checkpoint["seats"].get(role, ()):
            for name, value in seat["variables"].items():
                key = f"{seat['robot']}.{name}"
                found[f"{role}.{key}" if key in found else key] = value
    plain = {name: _plain(value) for name, value in found.items()}
    return {name: value for name, value in plain.items() if isinstance(value, bool | int | float | str)}


def _plain(value: Any) -> Any:
    """Return what a variable holds; a reading is kept as a mapping with one key."""
    return next(iter(value.values())) if isinstance(value, dict) and len(value) == 1 else value


def write_csv(results: Sequence[Result], scenario: Scenario, file: Path) -> None:
    """Write the table: varied parameters, seed, outcome, duration_s, each `expect`, variables, error, folder.

    An `expect` that held every time is `passed`, else `failed`; it is empty where it was never reached.

    Raises:
        OSError: the file cannot be written.
    """
    parameters = list(results[0].job.varied) if results else []
    expects = scenario.expectations()
    variables = list(dict.fromkeys(name for result in results for name in result.variables))
    heads = [*parameters, "seed", "outcome", "duration_s", *(f"expect {path}" for path in expects), *variables]
    with file.open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow([*heads, "error", "run"])
        for result in results:
            job = result.job
            cells = [*job.varied.values(), job.seed, result.outcome, result.duration_s]
            cells += [_HELD[result.expected.get(path)] for path in expects]
            cells += [result.variables.get(name) for name in variables]
            table.writerow([*map(_cell, cells), result.error, job.name])


def _cell(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return (
        json.dumps(list(value)) if isinstance(value, tuple) else repr(value) if isinstance(value, float) else str(value)
    )


def write_junit(results: Iterable[Result], name: str, file: Path) -> None:
    """Write a test case for each run: what is not good is a failure, what never ended an error.

    Args:
        results: the runs.
        name: of the suite.
        file: where to.

    Raises:
        OSError: the file cannot be written.
    """
    rows = list(results)
    suites = Xml.Element("testsuites")
    errors = sum(row.outcome in (REFUSED, CRASHED) for row in rows)
    counts = {"tests": len(rows), "failures": sum(not row.is_good for row in rows) - errors, "errors": errors}
    total_s = sum(row.duration_s or 0.0 for row in rows)
    attributes = {"name": name, **{key: str(count) for key, count in counts.items()}, "time": f"{total_s:.3f}"}
    suite = Xml.SubElement(suites, "testsuite", attributes)
    for row in rows:
        case = Xml.SubElement(
            suite,
            "testcase",
            {"classname": name, "name": row.job.label, "time": f"{row.duration_s or 0.0:.3f}"},
        )
        if not row.is_good:
            kind = "error" if row.outcome in (REFUSED, CRASHED) else "failure"
            told = {"type": row.outcome, "message": row.error or _broken(row)}
            Xml.SubElement(case, kind, told).text = f"{_broken(row)}\nrun: {row.job.name}"
    Xml.indent(suites)
    Xml.ElementTree(suites).write(file, encoding="utf-8", xml_declaration=True)


def _broken(result: Result) -> str:
    failed = [path for path, held in result.expected.items() if not held]
    return f"expect {', '.join(failed)}: failed" if failed else result.error
