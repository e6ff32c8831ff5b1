"""What is shown of a run when it is over."""

from __future__ import annotations

from collections import Counter
from typing import Final

from rich.console import Console
from rich.table import Table
from rich.text import Text

from eal_actors.cli.output import counted, new_table
from eal_actors.cli.progress import STYLES
from eal_actors.scenario import Report

_MOST_ROWS: Final = 30
"""A longer table says less than a shorter one."""


def print_summary(console: Console, report: Report) -> None:
    """Print how every call went; of a long run, how every robot fared. What failed is always told in full."""
    console.print()
    console.print(_step_table(report) if len(report.steps) <= _MOST_ROWS else _robot_table(report))
    console.print()
    console.print(_verdict(report), soft_wrap=True)
    for line in _errors(report):
        console.print(line, soft_wrap=True)


def _styled(outcome: str) -> Text:
    return Text(outcome, style=STYLES[outcome])


def _step_table(report: Report) -> Table:
    table = new_table("robot", "step", "result", "duration")
    table.columns[-1].justify = "right"
    for step in report.steps:
        result = _styled(step.outcome)
        if step.attempts > 1:
            result.append_text(Text(f" at attempt {step.attempts}"))
        table.add_row(step.robot or "", step.label, result, f"{step.end_s - step.start_s:.2f} s")
    return table


def _robot_table(report: Report) -> Table:
    """Return a row for each robot; where they are too many, for each that is not done, and one for the others."""
    table = new_table("robot", "result", "calls", "failed", "duration")
    for column in table.columns[2:]:
        column.justify = "right"
    calls = Counter(step.robot for step in report.steps if step.is_call)
    failed = Counter(step.robot for step in report.steps if step.outcome not in ("done", "stopped"))
    ends_s = {step.robot: step.end_s for step in report.steps}
    all_shown = len(report.robots) <= _MOST_ROWS
    silent = []
    for name, robot in report.robots.items():
        if all_shown or robot.outcome != "done":
            row = (str(calls[name]), str(failed[name] or ""), f"{ends_s.get(name, 0.0):.2f} s")
            table.add_row(name, _styled(robot.outcome), *row)
        else:
            silent.append(name)
    if silent:
        count, last_s = sum(calls[name] for name in silent), max(ends_s.get(name, 0.0) for name in silent)
        what = counted(len(silent), "robot" if len(silent) == len(report.robots) else "other robot")
        table.add_row(what, _styled("done"), str(count), "", f"{last_s:.2f} s")
    return table


def _errors(report: Report) -> list[Text]:
    """Return every failed call with its reason, and what went wrong beside the calls."""
    told: set[str] = set()
    lines: list[Text] = []
    for step in report.steps:
        if step.outcome in ("failed", "skipped", "replaced") and step.error is not None:
            who = f"{step.robot}  " if step.robot is not None else ""
            lines.append(_reason(f"{who}{step.label}", step.outcome, step.error.message))
            told.add(step.error.message)
    for name, robot in report.robots.items():
        if robot.error is not None and robot.error.message not in told:
            lines.append(_reason(name, robot.outcome, robot.error.message))
            told.add(robot.error.message)
    if report.error is not None and report.error.message not in told:
        lines.append(Text(report.error.message))
    return lines


def _reason(what: str, outcome: str, why: str) -> Text:
    return Text.assemble(f"{what}  ", (outcome, STYLES[outcome]), f": {why}")


def _verdict(report: Report) -> Text:
    robots = counted(len(report.robots), "robot")
    calls = counted(sum(step.is_call for step in report.steps), "call")
    skipped = sum(step.outcome == "skipped" for step in report.steps)
    skews = [start.skew_s for start in report.starts if start.skew_s is not None]
    return Text.assemble(
        f"{report.scenario} on {report.fleet}: ",
        (report.outcome, STYLES[report.outcome]),
        f", {robots}, {calls}, {report.duration_s:.2f} s",
        (f", {counted(skipped, 'step')} skipped", STYLES["skipped"]) if skipped else "",
        f", began together within {max(skews) * 1000:.1f} ms" if skews else "",
    )
