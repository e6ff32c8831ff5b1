"""What can be wrong with a scenario by itself: roles, variables, expressions, and steps in the wrong place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from eal_actors.kernel.errors import Problem
from eal_actors.kernel.yaml_tree import YamlPath, format_path
from eal_actors.scenario.checks.names import Loop, Scope
from eal_actors.scenario.checks.placing import Placing
from eal_actors.scenario.checks.saving import save_problems
from eal_actors.scenario.checks.texts import Texts
from eal_actors.scenario.checks.units import unit_problems
from eal_actors.scenario.expressions import expressions_in
from eal_actors.scenario.model import (
    INDEX,
    AnswerStep,
    AnyStep,
    BarrierStep,
    BlockStep,
    CallStep,
    ExpectStep,
    ForStep,
    IfStep,
    LetStep,
    LogStep,
    OnStep,
    ParallelStep,
    PythonStep,
    RepeatStep,
    ScenarioStep,
    SequenceStep,
    SignalStep,
    TimedStep,
    WaitForStep,
    WaitingStep,
    WaitStep,
    WaitUntilStep,
    WhileStep,
    call_fields,
    inner_steps,
)
from eal_actors.scenario.scenario import Scenario


def check_scope(scenario: Scenario) -> list[Problem]:
    """Return what is wrong with a scenario, whatever the fleet."""
    checker = _Checker(scenario)
    for name in scenario.file.parameters:
        checker.texts.check_name(name, ("parameters", name), key=True)
    checker.placing.roles()
    checker.visit_all(scenario.file.steps, ("steps",), Scope())
    checker.texts.saved = {}  # the end must not depend on how far the steps came
    checker.visit_all(scenario.file.finally_, ("finally",), Scope(is_finally=True))
    return checker.problems


class _Checker:
    """Walks through the steps in the order in which they run.

    Attributes:
        problems: what was found.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.problems: list[Problem] = []
        self._scenario = scenario
        self.texts = Texts(scenario, self.problems)
        self.placing = Placing(scenario, self.problems)

    def _report(self, path: YamlPath, message: str, *, key: bool = False) -> None:
        self.problems.append(self._scenario.problem(path, message, key=key))

    def visit_all(self, steps: Sequence[AnyStep], path: YamlPath, scope: Scope) -> None:
        """Check steps that follow each other."""
        for index, step in enumerate(steps):
            self._visit(step, (*path, index), scope)

    def _visit(self, step: AnyStep, path: YamlPath, scope: Scope) -> None:
        self.placing.step(step, path, scope)
        part = self._scenario.parts.get(format_path(path)) if isinstance(step, ScenarioStep) else None
        for keys, wrong in unit_problems(step, self._scenario.file, part.file if part is not None else None):
            self._report((*path, *keys), wrong)
        if isinstance(step, BlockStep | TimedStep | WaitingStep) and step.timeout_s is not None:
            self.texts.value(step.timeout_s, (*path, "timeout_s"), scope)
        inner = replace(scope, is_top=False)
        match step:
            case CallStep():
                self._call(step, path, scope)
            case OnStep():
                self.visit_all(step.do, (*path, "do"), replace(inner, role=scope.role or step.on, is_beside=True))
            case ParallelStep():
                for keys, steps in inner_steps(step):
                    self.visit_all(steps, (*path, *keys), replace(inner, is_beside=True))
            case SequenceStep():
                self.visit_all(step.sequence, (*path, "sequence"), inner)
            case ForStep() | RepeatStep() | WhileStep():
                self._loop(step, path, scope)
            case IfStep():
                self.texts.bare(step.if_, (*path, "if"), scope)
                for keys, steps in inner_steps(step):
                    self.visit_all(steps, (*path, *keys), inner)
            case ScenarioStep():
                for name, value in step.with_.items():
                    self.texts.value(value, (*path, "with", name), scope)
            case _:
                self._leaf(step, path, scope)

    def _leaf(self, step: AnyStep, path: YamlPath, scope: Scope) -> None:
        texts = self.texts
        match step:
            case WaitStep():
                texts.value(step.wait_s, (*path, "wait_s"), scope)
            case WaitUntilStep():
                texts.bare(step.wait_until, (*path, "wait_until"), scope)
            case SignalStep():
                texts.value(step.value, (*path, "value"), scope)
            case WaitForStep():
                texts.value(step.count, (*path, "count"), scope)
                texts.value(step.default, (*path, "default"), scope)
                texts.assign(step.save_as, (*path, "save_as"), scope)
            case LetStep():
                for name, value in step.let.items():
                    texts.bare(value, (*path, "let", name), scope)
                    texts.assign(name, (*path, "let", name), scope, key=True)
            case ExpectStep():
                self._expect(step, path, scope)
            case LogStep():
                texts.value(step.log, (*path, "log"), scope)
            case PythonStep():
                for name, value in step.with_.items():
                    texts.value(value, (*path, "with", name), scope)
                texts.assign(step.save_as, (*path, "save_as"), scope)
            case BarrierStep():
                pass

    def _expect(self, step: ExpectStep, path: YamlPath, scope: Scope) -> None:
        self.texts.bare(step.expect, (*path, "expect"), scope)
        self.texts.value(step.equals, (*path, "equals"), scope)
        self.texts.value(step.says, (*path, "says"), scope)
        if step.tolerance is not None and step.equals is None:
            self._report((*path, "tolerance"), "has no meaning without 'equals'", key=True)
        elif step.tolerance is not None and isinstance(step.equals, bool):
            self._report((*path, "tolerance"), "has no meaning for true and false", key=True)

    def _loop(self, step: ForStep | RepeatStep | WhileStep, path: YamlPath, scope: Scope) -> None:
        name, passes, is_static = INDEX, None, True
        if isinstance(step, ForStep):
            name, here = step.variable, (*path, "for", step.variable)
            self.texts.value(step.values, here, scope)
            passes = len(step.values) if isinstance(step.values, tuple) else None
            is_static = self.texts.is_static(step.values, scope)
            if name in scope.loops:
                self._report(here, f"'{name}' is the variable of a loop around this one already", key=True)
            self.texts.check_name(name, here, key=True)
        elif isinstance(step, RepeatStep):
            self.texts.value(step.repeat, (*path, "repeat"), scope)
            passes = step.repeat if isinstance(step.repeat, int) else None
            is_static = self.texts.is_static(step.repeat, scope)
        else:
            self.texts.bare(step.while_, (*path, "while"), scope.within(Loop(INDEX, None, is_static=False)))
            self.texts.value(step.limit, (*path, "limit"), scope)
            is_static = False
        self.visit_all(step.do, (*path, "do"), scope.within(Loop(name, passes, is_static)))

    def _call(self, step: CallStep, path: YamlPath, scope: Scope) -> None:
        self.texts.value(step.arguments.resource, (*path, step.kind, "resource"), scope, static="the resource")
        for name, value in call_fields(step).items():
            self.texts.value(value, (*path, step.kind, name), scope)
        if isinstance(step, AnswerStep):
            if step.save is not None:
                self.texts.value(step.save, (*path, "save"), scope)
                used = {name.name for expression in expressions_in(step.save) for name in expression.names}
                constants = scope.facts | self.texts.constants
                for problem in save_problems(step.save, used - constants, scope.around):
                    self._report((*path, "save"), problem)
            self.texts.assign(step.save_as, (*path, "save_as"), scope)
