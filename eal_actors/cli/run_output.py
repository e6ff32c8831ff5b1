"""Printed plan of a run (`eal run --dry-run`) and printed summary of a finished run."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.table import Table
from rich.text import Text
from rich.tree import Tree

from eal_actors.cli.output import counted, new_table, print_line
from eal_actors.cli.progress import STYLES
from eal_actors.kernel.bundled import short_path
from eal_actors.kernel.errors import ScenarioError
from eal_actors.scenario import Entry, Plan, Report, Scenario, StepRecord, Timeline
from eal_actors.scenario.language.parameters import describe
from eal_actors.scenario.steps.registry import kinds

_LEAVES: Final = ("dropped", "replaced")
_MOST_NAMES: Final = 6
_MOST_ROWS: Final = 30  # rows of the longest table of steps; longer runs get a table of robots


def plan_as_json(plan: Plan, fleet: str) -> dict[str, Any]:
    """Return a plan as JSON values."""
    timeline = Timeline.of(plan.scenario, plan.roles)
    return {
        "scenario": plan.scenario.name,
        "fleet": fleet,
        "parameters": dict(plan.scenario.parameters),
        "roles": {role: list(names) for role, names in plan.roles.items()},
        "spares": {role: list(names) for role, names in plan.spares.items()},
        "lost": {name: error.message for name, error in plan.lost.items()},
        "calls": plan.calls,
        "steps": [entry.to_dict() for entry in timeline.steps],
        "finally": [entry.to_dict() for entry in timeline.ending],
    }


def print_plan(console: Console, plan: Plan, fleet: str) -> None:
    """Print a plan as a tree: steps in their order, parallel branches side by side."""
    scenario = plan.scenario
    timeline = Timeline.of(scenario, plan.roles)
    about = f": {scenario.file.description}" if scenario.file.description else ""
    console.print(Text.assemble((f"{scenario.name} on {fleet}", "bold"), about))
    for name, value in scenario.parameters.items():
        text = list(value) if isinstance(value, tuple) else value
        print_line(console, Text(f"  {name} = {text}").append(f"  ({describe(scenario.file.parameters[name])})", "dim"))
    for role, names in plan.roles.items():
        spares = f"; spare: {_list_names(plan.spares[role])}" if plan.spares.get(role) else ""
        print_line(console, Text.assemble("  role ", (role, "bold"), f": {_list_names(names)}", (spares, "dim")))
    for name, error in plan.lost.items():
        print_line(console, f"  {name} does not take part: {error.message}", "yellow")
    console.print()
    for heading, entries in (("steps", timeline.steps), ("finally", timeline.ending)):
        if entries:
            console.print(_step_tree(heading, entries), soft_wrap=True)
    console.print()
    at_least = "" if all(entry.calls is not None for entry in timeline.steps) else "at least "
    calls = f"{at_least}{counted(plan.calls, 'call')} by {counted(len(plan.robots), 'robot')}"
    checked = "All values that are known before the run were checked against these robots."
    print_line(console, f"{calls}. {checked} Nothing has moved.")


def _list_names(names: Sequence[str]) -> str:
    more = len(names) - _MOST_NAMES
    return ", ".join(names[:_MOST_NAMES]) + (f" and {more} more" if more > 0 else "") if names else "no robot"


def _step_tree(heading: str, entries: Iterable[Entry]) -> Tree:
    tree = Tree(Text(heading, style="bold"), guide_style="dim")
    for entry in entries:
        _add_entry(tree, entry)
    return tree


def _add_entry(tree: Tree, entry: Entry) -> None:
    line = Text(entry.text)
    if entry.kind == "on":
        line.append(f": {_list_names(entry.robots)}", style="cyan")
    if entry.inner and entry.calls:
        line.append(f"  ({counted(entry.calls, 'call')})", style="dim")
    if entry.unknown:
        line.append(f"  needs {', '.join(entry.unknown)}", style="yellow")
    branch = tree.add(line)
    for inner in entry.inner:
        _add_entry(branch, inner)


def print_summary(console: Console, report: Report, scenario: Scenario) -> None:
    """Print the result of every call, or of every robot in a long run, and every error.

    An error of the scenario itself has its place in the file. The record has only the path of the step: it must be the
    same when a copy of the file is run.
    """
    console.print()
    console.print(_step_table(report) if len(report.steps) <= _MOST_ROWS else _robot_table(report))
    console.print()
    for line in (_verdict(report), *_errors(report, scenario)):
        print_line(console, line)


def _styled(outcome: str) -> Text:
    return Text(outcome, style=STYLES[outcome])


def _step_table(report: Report) -> Table:
    table = new_table("robot", "step", "result", "duration", right=("duration",))
    for step in report.steps:
        result = _styled(step.outcome)
        if step.attempts > 1:
            result.append_text(Text(f" at attempt {step.attempts}"))
        table.add_row(step.robot or "", step.label, result, f"{step.end_s - step.start_s:.2f} s")
    return table


def _robot_table(report: Report) -> Table:
    """Return a row for each robot; in a large fleet, for each robot that is not done, and one row for the others."""
    table = new_table("robot", "result", "calls", "failed", "duration", right=("calls", "failed", "duration"))
    calls = _calls(report)
    failed = Counter(step.robot for step in report.steps if step.outcome not in ("done", "stopped"))
    ends_s = {step.robot: step.end_s for step in report.steps}
    show_all = len(report.robots) <= _MOST_ROWS
    hidden = []
    for name, robot in report.robots.items():
        if show_all or robot.outcome != "done":
            row = (str(calls[name]), str(failed[name] or ""), f"{ends_s.get(name, 0.0):.2f} s")
            table.add_row(name, _styled(robot.outcome), *row)
        else:
            hidden.append(name)
    if hidden:
        count, last_s = sum(calls[name] for name in hidden), max(ends_s.get(name, 0.0) for name in hidden)
        noun = counted(len(hidden), "robot" if len(hidden) == len(report.robots) else "other robot")
        table.add_row(noun, _styled("done"), str(count), "", f"{last_s:.2f} s")
    return table


def _calls(report: Report) -> Counter[str | None]:
    """Return the number of calls by robot; a formation is one of each robot of its role that was still there."""
    calls = Counter(step.robot for step in report.steps if step.is_call)
    left_s = {step.robot: step.end_s for step in report.steps if step.robot is not None and step.outcome in _LEAVES}
    for step in report.steps:
        if step.role is not None and step.kind in kinds() and kinds()[step.kind].moves_its_role:
            calls.update(name for name in report.roles[step.role] if left_s.get(name, math.inf) > step.start_s)
    return calls


def _errors(report: Report, scenario: Scenario) -> list[Text]:
    """Return a line for each failed call, and for each error outside of calls."""
    places = _places(report, scenario)
    printed: set[str] = set()
    lines: list[Text] = []
    for step in report.steps:
        if step.outcome in ("failed", "skipped", "replaced") and step.error is not None:
            prefix = f"{step.robot}  " if step.robot is not None else ""
            reason = f"{_place(step, scenario)}{step.error.message}"
            lines.append(_error_line(f"{prefix}{step.label}", step.outcome, reason))
            printed.add(step.error.message)
    for name, robot in report.robots.items():
        if robot.error is not None and robot.error.message not in printed:
            reason = f"{places.get((name, robot.error.message), '')}{robot.error.message}"
            lines.append(_error_line(name, robot.outcome, reason))
            printed.add(robot.error.message)
    touched = report.contacts[:_MOST_ROWS]
    lines += [Text(f"{one.robot}  touched {one.other} at {one.time_s:.2f} s") for one in touched]
    if report.error is not None and report.error.message not in printed:
        lines.append(Text(report.error.message))
    return lines


def _place(step: StepRecord, scenario: Scenario) -> str:
    """Return the place in the file of a step that failed because of the scenario itself; empty for other errors."""
    if step.error is None or step.error.code != ScenarioError.code:
        return ""
    mark = scenario.position_of(step.step)
    return f"{short_path(Path(mark.file))}:{mark.line}:{mark.column}: "


def _places(report: Report, scenario: Scenario) -> dict[tuple[str | None, str], str]:
    """Return the places of errors, by robot and message: a block repeats the error of its step, which comes first."""
    found: dict[tuple[str | None, str], str] = {}
    for step in report.steps:
        if step.error is not None:
            found.setdefault((step.robot, step.error.message), _place(step, scenario))
    return found


def _error_line(name: str, outcome: str, reason: str) -> Text:
    return Text.assemble(f"{name}  ", _styled(outcome), f": {reason}")


def _verdict(report: Report) -> Text:
    robots = counted(len(report.robots), "robot")
    calls = counted(_calls(report).total(), "call")
    skipped = sum(step.outcome == "skipped" for step in report.steps)
    skews = [start.skew_s for start in report.starts if start.skew_s is not None]
    return Text.assemble(
        f"{report.scenario} on {report.fleet}: ",
        _styled(report.outcome),
        (f" without {', '.join(report.dropped)}", STYLES["dropped"]) if report.dropped else "",
        f", {robots}, {calls}, {report.duration_s:.2f} s",
        (f", {counted(skipped, 'step')} skipped", STYLES["skipped"]) if skipped else "",
        (f", {counted(len(report.contacts), 'contact')}", STYLES["skipped"]) if report.contacts else "",
        f", started together within {max(skews) * 1000:.1f} ms" if skews else "",
    )
