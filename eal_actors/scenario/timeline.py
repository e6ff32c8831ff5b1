"""What a plan will do, in order, before anything moves: who does what, with loops folded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from eal_actors.kernel.errors import EALError
from eal_actors.kernel.yaml_tree import YamlPath, format_path
from eal_actors.scenario.checks.names import ROBOT_FACTS, RUN
from eal_actors.scenario.expressions import Known, expressions_in, render
from eal_actors.scenario.model import (
    AnyStep,
    CallStep,
    ForStep,
    IfStep,
    OnStep,
    ParallelStep,
    RepeatStep,
    ScenarioStep,
    SequenceStep,
    WhileStep,
    inner_steps,
)
from eal_actors.scenario.scenario import Scenario
from eal_actors.scenario.wording import describe_step, step_expressions


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of a time line.

    Attributes:
        step: path of the step.
        kind: the key that tells what it is; `branch` for a branch of a `parallel`, `then` and `else` for those of `if`.
        text: what it does, for people.
        robots: who does it; empty outside of `on`.
        calls: how many calls it makes if nothing fails; None where that is known only during the run.
        unknown: what is known only during the run: variables and readings.
        inner: what it consists of.
    """

    step: str
    kind: str
    text: str
    robots: tuple[str, ...] = ()
    calls: int | None = 0
    unknown: tuple[str, ...] = ()
    inner: tuple[Entry, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return plain dicts, lists, strings and numbers."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class Timeline:
    """What a plan will do.

    Attributes:
        steps: the steps.
        ending: those of `finally`.
    """

    steps: tuple[Entry, ...]
    ending: tuple[Entry, ...]

    @classmethod
    def of(cls, scenario: Scenario, roles: Mapping[str, Sequence[str]]) -> Timeline:
        """Return the time line of a scenario with these robots in its roles."""
        teller = _Teller(scenario, roles)
        file = scenario.file
        return cls(teller.tell(file.steps, ("steps",), ()), teller.tell(file.finally_, ("finally",), ()))


def count_calls(scenario: Scenario, live: Mapping[str, int]) -> int:
    """Return how many calls the steps make if nothing fails, as far as is known; without those of `finally`.

    Args:
        scenario: the scenario.
        live: how many robots each role has.
    """
    return _count(scenario, scenario.file.steps, ("steps",), 1, live)


def _count(
    scenario: Scenario,
    steps: Sequence[AnyStep],
    path: YamlPath,
    robots: int,
    live: Mapping[str, int],
    *,
    is_on: bool = False,
) -> int:
    count = 0
    for index, step in enumerate(steps):
        here = (*path, index)
        if isinstance(step, CallStep):
            count += robots
        elif isinstance(step, OnStep):
            count += _count(scenario, step.do, (*here, "do"), live[step.on], live, is_on=True)
        elif isinstance(step, ForStep | RepeatStep):
            count += (_passes(scenario, step) or 0) * _count(
                scenario, step.do, (*here, "do"), robots, live, is_on=is_on
            )
        elif isinstance(step, ParallelStep | SequenceStep):
            for keys, inner in inner_steps(step):
                count += _count(scenario, inner, (*here, *keys), robots, live, is_on=is_on)
        elif isinstance(step, ScenarioStep):
            part = scenario.parts[format_path(here)]
            theirs = {role: robots if is_on else live[step.roles.get(role, role)] for role in part.file.roles}
            count += count_calls(part, theirs) + _count(part, part.file.finally_, ("finally",), 1, theirs)
    return count


def _passes(scenario: Scenario, step: ForStep | RepeatStep) -> int | None:
    """Return how often a loop goes round, or None where that is known only during the run."""
    if isinstance(step, ForStep):
        values: object = step.values
        if isinstance(values, tuple):
            return len(values)
        found = _static(scenario, step.values)
        return len(found) if isinstance(found, list | tuple) else None
    if isinstance(step.repeat, int):
        return step.repeat
    found = _static(scenario, step.repeat)
    return found if isinstance(found, int) else None


def _static(scenario: Scenario, value: object) -> object:
    """Return what a value stands for, where it depends on parameters alone; else None."""
    if any(
        expression.readings or any(name.name not in scenario.parameters for name in expression.names)
        for expression in expressions_in(value)
    ):
        return None
    try:
        return render(value, Known({**scenario.parameters, "run": {}}))
    except EALError:
        return None


class _Teller:
    """Puts the steps of one scenario in words."""

    def __init__(self, scenario: Scenario, roles: Mapping[str, Sequence[str]], prefix: str = "") -> None:
        self._scenario = scenario
        self._roles = roles
        self._prefix = prefix

    def tell(self, steps: Sequence[AnyStep], path: YamlPath, robots: tuple[str, ...]) -> tuple[Entry, ...]:
        """Return an entry for each step."""
        return tuple(self._entry(step, (*path, index), robots) for index, step in enumerate(steps))

    def _entry(self, step: AnyStep, path: YamlPath, robots: tuple[str, ...]) -> Entry:
        inner: tuple[Entry, ...] = ()
        factor: int | None = 1
        own = len(robots) if isinstance(step, CallStep) else 0
        if isinstance(step, OnStep):
            robots = tuple(self._roles[step.on])
            inner = self.tell(step.do, (*path, "do"), robots)
        elif isinstance(step, ForStep | RepeatStep | WhileStep):
            inner = self.tell(step.do, (*path, "do"), robots)
            factor = _passes(self._scenario, step) if not isinstance(step, WhileStep) else None
        elif isinstance(step, SequenceStep):
            inner = self.tell(step.sequence, (*path, "sequence"), robots)
        elif isinstance(step, ParallelStep | IfStep):
            inner = tuple(self._branch(step, keys, steps, path, robots) for keys, steps in inner_steps(step))
            factor = None if isinstance(step, IfStep) else 1
        elif isinstance(step, ScenarioStep):
            inner = self._part(step, path, robots)
        calls = [entry.calls for entry in inner]
        total = (
            None
            if any(call is None for call in calls) or (factor is None and any(calls))
            else (own + (factor or 0) * sum(call or 0 for call in calls))
        )
        text = describe_step(step, self._scenario.parameters)
        return Entry(f"{self._prefix}{format_path(path)}", step.kind, text, robots, total, self._unknown(step), inner)

    def _branch(
        self,
        step: ParallelStep | IfStep,
        keys: tuple[str | int, ...],
        steps: Sequence[AnyStep],
        path: YamlPath,
        robots: tuple[str, ...],
    ) -> Entry:
        inner = self.tell(steps, (*path, *keys), robots)
        calls = [entry.calls for entry in inner]
        total = None if any(call is None for call in calls) else sum(call or 0 for call in calls)
        kind = "branch" if isinstance(step, ParallelStep) else str(keys[-1])
        text = f"branch {keys[-1]}" if kind == "branch" else kind
        return Entry(f"{self._prefix}{format_path((*path, *keys))}", kind, text, robots, total, (), inner)

    def _part(self, step: ScenarioStep, path: YamlPath, robots: tuple[str, ...]) -> tuple[Entry, ...]:
        part = self._scenario.parts[format_path(path)]
        roles = {theirs: robots or self._roles[step.roles.get(theirs, theirs)] for theirs in part.file.roles}
        teller = _Teller(part, roles, f"{self._prefix}{format_path(path)}.{part.name}.")
        return (*teller.tell(part.file.steps, ("steps",), ()), *teller.tell(part.file.finally_, ("finally",), ()))

    def _unknown(self, step: AnyStep) -> tuple[str, ...]:
        """Return what a step itself needs that is known only during the run."""
        found: dict[str, None] = {}
        for expression, *_ in step_expressions(step):
            for name in expression.names:
                if name.name not in self._scenario.parameters and name.name not in ROBOT_FACTS and name.name != RUN:
                    found[name.name] = None
            for reading, _ in expression.readings:
                found[str(reading)] = None
        return tuple(found)
