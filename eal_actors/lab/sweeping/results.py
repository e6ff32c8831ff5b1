"""Results of the runs of a sweep, as a table (CSV) and as test cases (JUnit XML)."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeAlias
from xml.etree import ElementTree as Xml

from eal_actors.lab.sweeping.sweep import SweepJob
from eal_actors.recording import RunFolder
from eal_actors.scenario import Report, Scenario

Scalar: TypeAlias = bool | int | float | str

REFUSED: Final = "refused"
"""The run did not start: the robots cannot perform it with these values."""
CRASHED: Final = "crashed"
"""The worker process of the run died."""
_NOT_XML: Final = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_HELD: Final = {True: "passed", False: "failed", None: ""}


@dataclass(frozen=True, slots=True)
class SweepResult:
    """The result of one run.

    Attributes:
        outcome: `done`, `failed` or `aborted`; REFUSED or CRASHED if the run did not end.
        duration_s: fleet seconds; None if the run did not end.
        expected: whether each reached `expect` held every time, by its path.
        variables: last values of numbers, texts and booleans: variables of the run by name, of robots by `robot.name`.
    """

    job: SweepJob
    outcome: str
    duration_s: float | None = None
    error: str = ""
    expected: Mapping[str, bool] = field(default_factory=dict)
    variables: Mapping[str, Scalar] = field(default_factory=dict)

    @property
    def is_good(self) -> bool:
        """Whether the run is done and every expectation held."""
        return self.outcome == "done" and all(self.expected.values())


def read_result(job: SweepJob, folder: RunFolder, scenario: Scenario) -> SweepResult:
    """Return the result of a run that has ended; raise ScenarioError if the run's record is broken."""
    report = folder.summary
    if report is None:
        return SweepResult(job, CRASHED, error="has no summary")
    error = report.error.message if report.error is not None else ""
    known = set(scenario.expectations())
    expected: dict[str, bool] = {}
    for step in report.steps:
        if step.step in known and step.outcome not in ("aborted", "stopped"):
            expected[step.step] = expected.get(step.step, True) and step.error is None
    return SweepResult(job, report.outcome, report.duration_s, error, expected, _variables(folder, report))


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
    values = {name: _unwrap_reading(value) for name, value in found.items()}
    return {name: value for name, value in values.items() if isinstance(value, bool | int | float | str)}


def _unwrap_reading(value: Any) -> Any:
    """Return the value of a variable; a reading is recorded as a mapping with one key."""
    return next(iter(value.values())) if isinstance(value, dict) and len(value) == 1 else value


def write_csv(results: Sequence[SweepResult], scenario: Scenario, file: Path) -> None:
    """Write the table: varied parameters, seed, outcome, duration_s, each `expect`, variables, error, folder.

    An `expect` is `passed` if it held every time, else `failed`; its cell is empty if it was never reached. Raises
    OSError if the file cannot be written.
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
    if isinstance(value, tuple):
        return json.dumps(list(value))
    return repr(value) if isinstance(value, float) else str(value)


def write_junit(results: Iterable[SweepResult], name: str, file: Path) -> None:
    """Write a test case for each run: a failure if it is not good, an error if it did not end.

    Raises OSError if the file cannot be written.
    """
    rows = list(results)
    suites = Xml.Element("testsuites")
    errors = sum(row.outcome in (REFUSED, CRASHED) for row in rows)
    counts = {"tests": len(rows), "failures": sum(not row.is_good for row in rows) - errors, "errors": errors}
    total_s = sum(row.duration_s or 0.0 for row in rows)
    attributes = {"name": name, **{key: str(count) for key, count in counts.items()}, "time": f"{total_s:.3f}"}
    suite = Xml.SubElement(suites, "testsuite", attributes)
    for row in rows:
        attributes = {"classname": name, "name": _xml(row.job.label), "time": f"{row.duration_s or 0.0:.3f}"}
        case = Xml.SubElement(suite, "testcase", attributes)
        if not row.is_good:
            kind = "error" if row.outcome in (REFUSED, CRASHED) else "failure"
            attributes = {"type": row.outcome, "message": _xml(row.error or _failed_expectations(row))}
            Xml.SubElement(case, kind, attributes).text = _xml(f"{_failed_expectations(row)}\nrun: {row.job.name}")
    Xml.indent(suites)
    Xml.ElementTree(suites).write(file, encoding="utf-8", xml_declaration=True)


def _xml(text: str) -> str:
    """Return a text with the characters written out that XML has no form for, such as those of a robot's message."""
    return _NOT_XML.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def _failed_expectations(result: SweepResult) -> str:
    failed = [path for path, held in result.expected.items() if not held]
    return f"expect {', '.join(failed)}: failed" if failed else result.error
