"""The step `scenario`: run another scenario, with variables of its own."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from pydantic import Field
from typing_extensions import override

from eal_actors.actors.future import Future
from eal_actors.kernel.errors import EALError, Problem, ScenarioError
from eal_actors.kernel.strict_model import NAMES_ONLY, Name
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.kernel.yaml_tree import YamlPath, format_path
from eal_actors.scenario.engine.computing import compute
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.executor import StepGroup, perform_steps, perform_within
from eal_actors.scenario.engine.frames import ExecutionContext, Frame, StepTask
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.engine.synchronization import find_meetings
from eal_actors.scenario.language.expressions.evaluation import Namespace, expressions_in, render, to_plain
from eal_actors.scenario.language.parameters import parameter_problem
from eal_actors.scenario.language.robot_check import RobotCheck, RobotScope
from eal_actors.scenario.language.scenario import Keys, RobotsByRole, Scenario, Show, Step
from eal_actors.scenario.language.scope import Scope, ScopeCheck, signals_of
from eal_actors.scenario.language.static_values import StaticValues
from eal_actors.scenario.language.values import Text, Value, VariableName
from eal_actors.scenario.report.timeline import StepTimeline, TimelineBuilder
from eal_actors.scenario.steps.base import BlockStep


class ScenarioStep(BlockStep, kind="scenario"):
    """Run another scenario, with variables of its own. Inside an `on`, each robot runs it alone, in all of its roles.

    `on_failure` is for its parameters and for its time-out. Its steps have policies of their own.
    """

    scenario: Text
    """Its file, relative to this one."""
    with_: dict[VariableName, Value] = Field(default={}, alias="with", json_schema_extra=NAMES_ONLY)
    """Its parameters."""
    roles: dict[Name, Name] = Field(default={}, json_schema_extra=NAMES_ONLY)
    """Its roles to roles of this scenario; the others have the same name here. Not inside an `on`."""
    signals: dict[Name, Name] = Field(default={}, json_schema_extra=NAMES_ONLY)
    """Its signals to signals of this scenario that are given with them."""

    @property
    @override
    def part_file(self) -> str:
        return self.scenario

    @override
    def children(self) -> Sequence[tuple[Keys, tuple[Step, ...]]]:
        return ()  # they belong to another scenario

    @override
    def given_signals(self) -> Iterable[str]:
        return self.signals.values()

    @override
    def roles_at_work(self, scenario: Scenario, path: YamlPath) -> Iterator[str]:
        part = scenario.parts.get(format_path(path))
        for theirs in part.file.roles if part is not None else ():
            yield self.roles.get(theirs, theirs)

    @override
    def templates(self) -> Iterable[tuple[Keys, object]]:
        return (*super().templates(), *((("with", name), value) for name, value in self.with_.items()))

    # Checks.

    @override
    def check_placement(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        super().check_placement(check, path, scope)
        part = check.scenario.parts.get(format_path(path))
        if part is None:  # the loader has reported it
            return
        if scope.role is None:
            self._check_roles(check, part, path)
        else:
            self._check_alone(check, part, path, scope.role)
        given = signals_of(part)
        for name in self.signals:
            if name not in given:
                hint = did_you_mean(name, given) or "; it gives none"
                message = f"scenario '{part.name}' does not give the signal '{name}'{hint}"
                check.report((*path, "signals", name), message, key=True)
        self._check_parameters(check, part, path)

    def _check_alone(self, check: ScopeCheck, part: Scenario, path: YamlPath, role: str) -> None:
        """Check a scenario that each robot of an `on` runs alone."""
        if self.roles:
            message = f"has no meaning inside 'on: {role}': each robot takes all roles of the scenario by itself"
            check.report((*path, "roles"), message, key=True)
        for name in part.named:
            message = f"inside 'on: {role}' each robot runs it by itself, but it names the robot '{name}'"
            check.report((*path, "scenario"), message)
        for theirs, section in part.file.roles.items():
            if section.min > 1:
                message = (
                    f"inside 'on: {role}' each robot runs it by itself, "
                    f"but role '{theirs}' of scenario '{part.name}' needs at least {section.min}"
                )
                check.report((*path, "scenario"), message)

    def _check_roles(self, check: ScopeCheck, part: Scenario, path: YamlPath) -> None:
        known = check.scenario.file.roles
        for theirs, ours in self.roles.items():
            here = (*path, "roles", theirs)
            if theirs not in part.file.roles:
                hint = did_you_mean(theirs, part.file.roles)
                check.report(here, f"unknown role '{theirs}' of scenario '{part.name}'{hint}", key=True)
            if ours not in known:
                check.report(here, f"unknown role '{ours}'{did_you_mean(ours, known)}")
        for theirs in part.file.roles:
            if theirs not in self.roles and theirs not in known:
                message = f"which robots take role '{theirs}' of scenario '{part.name}'? Add roles: {{{theirs}: ...}}"
                check.report((*path, "scenario"), message)

    def _check_parameters(self, check: ScopeCheck, part: Scenario, path: YamlPath) -> None:
        declared = part.file.parameters
        for name, value in self.with_.items():
            here, section = (*path, "with", name), declared.get(name)
            if section is None:
                hint = did_you_mean(name, declared) or "; it has none"
                check.report(here, f"unknown parameter '{name}' of scenario '{part.name}'{hint}", key=True)
                continue
            check.unit(value, here, section.unit, f"parameter '{name}'")
            if not (isinstance(value, str) and "${" in value) and (wrong := parameter_problem(section, value)):
                check.report(here, wrong)
        for name, section in declared.items():
            if section.default is None and name not in self.with_:
                message = f"parameter '{name}' of scenario '{part.name}' has no default: give it under 'with'"
                check.report((*path, "scenario"), message)

    @override
    def check_robots(self, check: RobotCheck, path: YamlPath, here: RobotScope) -> None:
        super().check_robots(check, path, here)
        part = here.scenario.parts.get(format_path(path))
        if part is None:  # the loader has reported it
            return
        constants: dict[str, object] = dict(part.parameters)
        for name, value in self.with_.items():
            at = (*path, "with", name)
            expressions = expressions_in(value)
            names = {found.name for expression in expressions for found in expression.names}
            constants.pop(name, None)
            if not names <= set(here.values.constants) or any(expression.readings for expression in expressions):
                continue
            try:
                found = render(value, Namespace(here.values.constants))
            except EALError as error:
                check.report(here, at, error.message)
                continue
            if (problem := parameter_problem(part.file.parameters[name], found)) is not None:
                check.report(here, at, problem)
            constants[name] = found
        own = here.role or None
        roles = {theirs: here.roles.get(own or self.roles.get(theirs, theirs), ()) for theirs in part.file.roles}
        values = StaticValues({**constants, "run": here.values.constants["run"]})
        check.visit_file(RobotScope(part, roles, values, is_of_one=here.is_of_one or own is not None))

    @override
    def shared_robots(self, scenario: Scenario, path: YamlPath, roles: RobotsByRole) -> Iterator[Problem]:
        if (part := scenario.parts.get(format_path(path))) is not None:
            yield from part.shared_robots({role: roles.get(self.roles.get(role, role), ()) for role in part.file.roles})

    # Wording and planning.

    @override
    def block_words(self, show: Show) -> str:
        given = ", ".join(f"{name}={show(value)}" for name, value in self.with_.items())
        return f"scenario {self.scenario}" + (f" with {given}" if given else "")

    @override
    def timeline(self, builder: TimelineBuilder, path: YamlPath, robots: tuple[str, ...]) -> StepTimeline:
        part = builder.scenario.parts[format_path(path)]
        roles = {theirs: robots or builder.roles[self.roles.get(theirs, theirs)] for theirs in part.file.roles}
        return robots, builder.part(part, path, roles)

    @override
    def count_calls(self, scenario: Scenario, path: YamlPath, robots: int | None, live: Mapping[str, int]) -> int:
        part = scenario.parts[format_path(path)]
        theirs = {
            role: live.get(self.roles.get(role, role), 0) if robots is None else robots for role in part.file.roles
        }
        steps = part.count_calls(part.file.steps, ("steps",), None, theirs)
        return steps + part.count_calls(part.file.finally_, ("finally",), None, theirs)

    # Execution.

    @override
    def perform(self, run: RunContext, context: ExecutionContext, path: str) -> Coroutine:
        outer, slot = context.frame, context.slot
        scenario = outer.scenario.parts[path.removeprefix(outer.prefix)]
        parameters = yield from self._parameters(run, context, scenario, path)
        if parameters is None:
            return
        roles = {theirs: outer.roles[self.roles.get(theirs, theirs)] for theirs in scenario.file.roles if slot is None}
        frame = Frame(scenario, roles, parameters, f"{path}.{scenario.name}.", outer, self.signals, slot)
        meets = find_meetings(frame, scenario.file.steps)
        task = StepTask(context.task, slot, meets=meets)
        here = replace(context, task=task, frame=frame, loops={}, policy=None, attempt=None)
        run.open_parts.append(here)

        def steps(around: ExecutionContext) -> Coroutine:
            return perform_steps(run, scenario.file.steps, f"{frame.prefix}steps", replace(here, task=around.task))

        work = perform_within(run, replace(context, task=task), self, self.timeout_s, path, meets, steps)
        yield from StepGroup(run, context, "all").perform([(task, work)])
        end = StepTask(context.task, slot)  # not stopped, if a block around it was
        if not run.may_begin(replace(context, task=end)):
            return
        ending = replace(here, task=end, is_finally=True)
        yield from perform_steps(run, scenario.file.finally_, f"{frame.prefix}finally", ending)
        if not run.is_stopping:  # otherwise it is performed from its beginning at the end of the run
            run.open_parts.remove(here)
            run.forget(frame)

    def _parameters(
        self, run: RunContext, context: ExecutionContext, scenario: Scenario, path: str
    ) -> Generator[Future[Any], None, dict[str, object] | None]:
        """Return the values of the scenario's parameters, or None if that failed."""
        parameters = dict(scenario.parameters)

        def work(names: Namespace) -> dict[str, object]:
            for name, value in self.with_.items():
                found = to_plain(render(value, names), name)
                if (problem := parameter_problem(scenario.file.parameters[name], found)) is not None:
                    raise ScenarioError(f"parameter '{name}' of scenario '{scenario.name}' {problem}")
                parameters[name] = found
            run.keep(parameters)
            return parameters

        needed = expressions_in(tuple(self.with_.values()))
        found: dict[str, object] | None = yield from compute(
            run, context, self, path, f"scenario {self.scenario}", needed, work
        )
        return found
