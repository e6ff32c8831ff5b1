"""`eal run --dry-run`: what a plan will do, before anything moves."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final

from rich.console import Console
from rich.text import Text
from rich.tree import Tree

from eal_actors.cli.output import counted
from eal_actors.scenario import Entry, Plan, Timeline
from eal_actors.scenario.language.parameters import describe

_MOST_NAMES: Final = 6


def plan_as_json(plan: Plan, fleet: str) -> dict[str, Any]:
    """Return a plan in plain values."""
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
    """Print a plan as a time line: from top to bottom what comes one after the other, branches side by side."""
    scenario = plan.scenario
    timeline = Timeline.of(scenario, plan.roles)
    title = f"{scenario.name} on {fleet}"
    console.print(
        Text(title, style="bold").append(f": {scenario.file.description}" if scenario.file.description else "")
    )
    for name, value in scenario.parameters.items():
        section = scenario.file.parameters[name]
        shown = list(value) if isinstance(value, tuple) else value
        console.print(Text(f"  {name} = {shown}").append(f"  ({describe(section)})", style="dim"), soft_wrap=True)
    for role, names in plan.roles.items():
        line = Text.assemble("  role ", (role, "bold"), f": {_names(names)}")
        if spares := plan.spares.get(role):
            line.append(f"; in reserve: {_names(spares)}", style="dim")
        console.print(line, soft_wrap=True)
    for name, error in plan.lost.items():
        console.print(Text(f"  {name} takes no part: {error.message}", style="yellow"), soft_wrap=True)
    console.print()
    for heading, entries in (("steps", timeline.steps), ("finally", timeline.ending)):
        if entries:
            console.print(_tree(heading, entries), soft_wrap=True)
    console.print()
    console.print(_sum(plan, timeline), soft_wrap=True)


def _names(names: Sequence[str]) -> str:
    more = len(names) - _MOST_NAMES
    return ", ".join(names[:_MOST_NAMES]) + (f" and {more} more" if more > 0 else "") if names else "nobody"


def _tree(heading: str, entries: Iterable[Entry]) -> Tree:
    tree = Tree(Text(heading, style="bold"), guide_style="dim")
    for entry in entries:
        _add(tree, entry)
    return tree


def _add(tree: Tree, entry: Entry) -> None:
    line = Text(entry.text)
    if entry.kind == "on":
        line.append(f": {_names(entry.robots)}", style="cyan")
    if entry.inner and entry.calls:
        line.append(f"  ({counted(entry.calls, 'call')})", style="dim")
    if entry.unknown:
        line.append(f"  needs {', '.join(entry.unknown)}", style="yellow")
    branch = tree.add(line)
    for inner in entry.inner:
        _add(branch, inner)


def _sum(plan: Plan, timeline: Timeline) -> Text:
    is_known = all(entry.calls is not None for entry in timeline.steps)
    calls = counted(plan.calls, "call") if is_known else f"at least {counted(plan.calls, 'call')}"
    fits = "Every value that is known beforehand was checked against these robots."
    return Text(f"{calls} by {counted(len(plan.robots), 'robot')}. {fits} Nothing has moved.")
