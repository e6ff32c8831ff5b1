"""What can be wrong with a scenario by itself: roles, variables, and calls that no robot carries out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from eal_actors.errors import Problem, ScenarioError
from eal_actors.scenario.calls import AnswerStep, CallStep, call_fields
from eal_actors.scenario.files import suffix_problem
from eal_actors.scenario.model import ForStep, LogStep, OnStep, RepeatStep, ScenarioFile, Step
from eal_actors.scenario.variables import names_in, unknown_variable
from eal_actors.strict_model import did_you_mean
from eal_actors.yaml_tree import YamlPath, YamlTree


class _Loop(NamedTuple):
    """A loop's variable, and how many values it takes."""

    name: str
    passes: int


@dataclass(frozen=True, slots=True)
class _Scope:
    """What is known where a step stands.

    Attributes:
        role: the role of the `on` around it.
        around: the loops around it, from the outermost.
        is_finally: it belongs to `finally`.
    """

    role: str | None = None
    around: tuple[_Loop, ...] = ()
    is_finally: bool = False

    @property
    def loops(self) -> frozenset[str]:
        """The variables of the loops."""
        return frozenset(loop.name for loop in self.around)

    def inside(self, step: ForStep | RepeatStep) -> _Scope:
        """Return the scope of a loop's steps."""
        name, values = step.loop
        return replace(self, around=(*self.around, _Loop(name, len(values))))


def check_scope(file: ScenarioFile, tree: YamlTree) -> list[Problem]:
    """Return what is wrong with a scenario, whatever the fleet.

    Args:
        file: the scenario.
        tree: what it was read from.
    """
    checker = _Checker(file, tree)
    checker.visit_all(file.steps, ("steps",), _Scope())
    checker.saved = {}  # the end must not depend on how far the steps came
    checker.visit_all(file.finally_, ("finally",), _Scope(is_finally=True))
    return checker.problems


class _Checker:
    """Walks through the steps in the order in which they run.

    Attributes:
        problems: what was found.
        saved: the variables that earlier steps save, by role.
    """

    def __init__(self, file: ScenarioFile, tree: YamlTree) -> None:
        self.problems: list[Problem] = []
        self.saved: dict[str, set[str]] = {}
        self._file = file
        self._tree = tree

    def visit_all(self, steps: Sequence[Step], path: YamlPath, scope: _Scope) -> None:
        """Check steps that follow each other."""
        for index, step in enumerate(steps):
            self._visit(step, (*path, index), scope)

    def _visit(self, step: Step, path: YamlPath, scope: _Scope) -> None:
        if isinstance(step, CallStep):
            self._call(step, path, scope)
        elif isinstance(step, OnStep):
            self._on(step, path, scope)
        elif isinstance(step, ForStep):
            self._for(step, path, scope)
        elif isinstance(step, RepeatStep):
            self.visit_all(step.do, (*path, "do"), scope.inside(step))
        elif isinstance(step, LogStep):
            self._texts(step.log, (*path, "log"), scope)

    def _report(self, path: YamlPath, message: str, *, key: bool = False) -> None:
        self.problems.append(self._tree.problem(path, message, key=key))

    def _on(self, step: OnStep, path: YamlPath, scope: _Scope) -> None:
        if step.on not in self._file.roles:
            self._report((*path, "on"), f"unknown role '{step.on}'{did_you_mean(step.on, self._file.roles)}")
        if scope.role is not None:
            self._report(
                (*path, "on"), f"stands inside 'on: {scope.role}'; a robot goes through one 'on' at a time", key=True
            )
        self.visit_all(step.do, (*path, "do"), replace(scope, role=scope.role or step.on))

    def _for(self, step: ForStep, path: YamlPath, scope: _Scope) -> None:
        name, values = step.loop
        if name in scope.loops:
            self._report((*path, "for", name), f"'{name}' is the variable of a loop around this one already", key=True)
        for index, value in enumerate(values):
            if "${" in str(value):
                message = "the values of a loop are taken as they stand; ${...} has no meaning in them"
                self._report((*path, "for", name, index), message)
        self.visit_all(step.do, (*path, "do"), scope.inside(step))

    def _call(self, step: CallStep, path: YamlPath, scope: _Scope) -> None:
        if scope.role is None:
            self._report(
                (*path, step.method), f"which robot? '{step.method}' must stand in the 'do' of an 'on'", key=True
            )
        if scope.is_finally and step.on_failure is not None:
            message = "has no effect in 'finally': a failure there is recorded, and the next step runs"
            self._report((*path, "on_failure"), message, key=True)
        self._texts(step.arguments.resource, (*path, step.method, "resource"), scope, loops_only=True)
        for name, value in call_fields(step).items():
            self._texts(value, (*path, step.method, name), scope)
        if isinstance(step, AnswerStep):
            self._answer(step, path, scope)

    def _answer(self, step: AnswerStep, path: YamlPath, scope: _Scope) -> None:
        if step.save is not None:
            self._save(step.save, (*path, "save"), scope)
        if step.save_as is not None:
            if step.save_as in scope.loops:
                self._report((*path, "save_as"), f"'{step.save_as}' is the variable of a loop around this step")
            self.saved.setdefault(scope.role or "", set()).add(step.save_as)

    def _save(self, name: str, path: YamlPath, scope: _Scope) -> None:
        self._texts(name, path, scope)
        if problem := suffix_problem(name):
            self._report(path, problem)
        try:
            used = frozenset(names_in(name))
        except ScenarioError:  # reported with its text
            return
        if used <= scope.loops:  # with what is saved during the run, no name need come twice
            for problem in _overwrites(used, scope.around):
                self._report(path, problem)

    def _texts(self, value: object, path: YamlPath, scope: _Scope, *, loops_only: bool = False) -> None:
        """Check the variables in a value, item by item where it is a list."""
        if isinstance(value, tuple):
            for index, item in enumerate(value):
                self._texts(item, (*path, index), scope, loops_only=loops_only)
            return
        try:
            names = names_in(value)
        except ScenarioError as error:
            self._report(path, error.message)
            return
        saved = self.saved.get(scope.role or "", set())
        for name in names:
            if name not in scope.loops and name not in saved:
                self._report(path, unknown_variable(name, scope.loops | saved))
            elif loops_only and name not in scope.loops:
                self._report(path, f"the resource must be known before the run, and '{name}' is saved during it")


def _overwrites(used: frozenset[str], around: Sequence[_Loop]) -> list[str]:
    """Return which loops around a step have a file of its overwritten.

    Args:
        used: the variables in the file's name.
        around: the loops, from the outermost.
    """
    problems: dict[str, None] = {}
    for number, loop in enumerate(around):
        if loop.passes == 1:
            continue
        if loop.name not in used:
            problems[f"each pass of the loop around it overwrites the file: its name lacks ${{{loop.name}}}"] = None
        elif any(inner.name == loop.name for inner in around[number + 1 :]):
            message = "each pass of the outer 'repeat' overwrites the files of the one before: "
            hidden = f"${{{loop.name}}} is that of the inner 'repeat' here; write one of them as a 'for'"
            problems[message + hidden] = None
    return list(problems)
