"""Which step may stand where, and with what beside it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from eal_actors.kernel.errors import Problem
from eal_actors.kernel.strict_model import did_you_mean
from eal_actors.kernel.yaml_tree import YamlPath, format_path
from eal_actors.scenario.checks.names import Scope
from eal_actors.scenario.model import (
    AnyStep,
    BarrierStep,
    BlockStep,
    CallStep,
    FallibleStep,
    OnFailure,
    OnStep,
    ParallelStep,
    ScenarioStep,
    SignalStep,
    WaitForStep,
    final_action,
    inner_steps,
)
from eal_actors.scenario.parameters import parameter_problem
from eal_actors.scenario.scenario import Scenario


class Placing:
    """Checks steps one by one against what stands around them."""

    def __init__(self, scenario: Scenario, problems: list[Problem]) -> None:
        self._scenario = scenario
        self._file = scenario.file
        self._problems = problems
        self._signals = _signals_of(scenario)

    def _report(self, path: YamlPath, message: str, *, key: bool = False) -> None:
        self._problems.append(self._scenario.problem(path, message, key=key))

    def roles(self) -> None:
        """Check what roles say of themselves."""
        for name, role in self._file.roles.items():
            if role.max is not None and role.max < role.min:
                self._report(("roles", name, "max"), f"is below 'min', {role.min}")
            if role.on_failure is not None:
                self._spares(role.on_failure, ("roles", name, "on_failure"), [name])
        self._spares(self._file.on_failure, ("on_failure",), self._file.roles)

    def _spares(self, policy: OnFailure, path: YamlPath, roles: Iterable[str]) -> None:
        if final_action(policy) == "substitute" and not any(
            self._file.roles[role].spares for role in roles if role in self._file.roles
        ):
            words = " or ".join(f"'{role}'" for role in roles)
            self._report(path, f"no spare can take a robot's place: give role {words} 'spares: 1'", key=True)

    def step(self, step: AnyStep, path: YamlPath, scope: Scope) -> None:
        """Check one step."""
        if step.safe_to_repeat is not None and not (scope.is_top and path[0] == "steps"):
            self._report((*path, "safe_to_repeat"), "stands only with steps of the top level", key=True)
        if step.on_failure is not None:
            self._policy(step, step.on_failure, path, scope)
        match step:
            case CallStep() if scope.role is None:
                message = f"which robot? '{step.kind}' must stand in the 'do' of an 'on'"
                self._report((*path, step.kind), message, key=True)
            case OnStep():
                self._on(step, path, scope)
            case ParallelStep():
                self._until(step.until, path)
                self._roles_apart(step, path, scope)
            case BarrierStep() if not scope.is_beside:
                message = "nobody is there to meet: a barrier stands inside an 'on' or a 'parallel'"
                self._report((*path, "barrier"), message, key=True)
            case WaitForStep():
                self._signal(step.wait_for, (*path, "wait_for"))
            case ScenarioStep():
                self._part(step, path, scope)

    def _policy(self, step: FallibleStep, policy: OnFailure, path: YamlPath, scope: Scope) -> None:
        here = (*path, "on_failure")
        if scope.is_finally:
            message = "has no effect in 'finally': a failure there is recorded, and the next step runs"
            self._report(here, message, key=True)
            return
        action = final_action(policy)
        if action not in ("drop", "substitute"):
            return
        role = scope.role or (step.on if isinstance(step, OnStep) else None)
        if role is None and not isinstance(step, BlockStep):
            self._report(here, f"there is no robot to {action} here: the step stands in no 'on'", key=True)
        elif role is not None:
            self._spares(policy, here, [role])

    def _on(self, step: OnStep, path: YamlPath, scope: Scope) -> None:
        if step.on not in self._file.roles:
            self._report((*path, "on"), f"unknown role '{step.on}'{did_you_mean(step.on, self._file.roles)}")
        if scope.role is not None:
            message = f"stands inside 'on: {scope.role}'; a robot goes through one 'on' at a time"
            self._report((*path, "on"), message, key=True)
        self._until(step.until, path)

    def _until(self, until: str, path: YamlPath) -> None:
        if until not in ("all", "first") and until not in self._signals:
            known = {"all", "first", *self._signals}
            self._report((*path, "until"), f"must be all, first or a signal, not '{until}'{did_you_mean(until, known)}")

    def _signal(self, name: str, path: YamlPath) -> None:
        if name not in self._signals:
            hint = did_you_mean(name, self._signals) or "; the scenario gives no signal"
            self._report(path, f"nobody gives the signal '{name}'{hint}")

    def _roles_apart(self, step: ParallelStep, path: YamlPath, scope: Scope) -> None:
        if scope.role is not None:
            return
        taken: dict[str, str] = {}
        for keys, steps in inner_steps(step):
            branch = str(keys[-1])
            for role in dict.fromkeys(roles_of(steps, (*path, *keys), self._scenario)):
                if taken.setdefault(role, branch) != branch:
                    message = f"role '{role}' is at work in branch '{taken[role]}' at the same time"
                    self._report((*path, *keys), message)

    def _part(self, step: ScenarioStep, path: YamlPath, scope: Scope) -> None:
        part = self._scenario.parts.get(format_path(path))
        if part is None:  # reported when it was read
            return
        if scope.role is None:
            self._part_roles(step, part, path)
        else:
            self._part_of_one(step, part, path, scope.role)
        given = _signals_of(part)
        for name in step.signals:
            if name not in given:
                hint = did_you_mean(name, given) or "; it gives none"
                message = f"scenario '{part.name}' does not give the signal '{name}'{hint}"
                self._report((*path, "signals", name), message, key=True)
        self._part_parameters(step, part, path)

    def _part_of_one(self, step: ScenarioStep, part: Scenario, path: YamlPath, role: str) -> None:
        """Check a scenario that each robot of an `on` carries out by itself."""
        if step.roles:
            message = f"has no meaning inside 'on: {role}': each robot takes all roles of the scenario by itself"
            self._report((*path, "roles"), message, key=True)
        for theirs, section in part.file.roles.items():
            if section.min > 1:
                message = (
                    f"inside 'on: {role}' each robot carries it out by itself, "
                    f"but role '{theirs}' of scenario '{part.name}' needs at least {section.min}"
                )
                self._report((*path, "scenario"), message)

    def _part_roles(self, step: ScenarioStep, part: Scenario, path: YamlPath) -> None:
        for theirs, ours in step.roles.items():
            here = (*path, "roles", theirs)
            if theirs not in part.file.roles:
                known = did_you_mean(theirs, part.file.roles)
                self._report(here, f"unknown role '{theirs}' of scenario '{part.name}'{known}", key=True)
            if ours not in self._file.roles:
                self._report(here, f"unknown role '{ours}'{did_you_mean(ours, self._file.roles)}")
        for theirs in part.file.roles:
            if theirs not in step.roles and theirs not in self._file.roles:
                message = (
                    f"which robots take role '{theirs}' of scenario '{part.name}'? Say so: roles: {{{theirs}: ...}}"
                )
                self._report((*path, "scenario"), message)

    def _part_parameters(self, step: ScenarioStep, part: Scenario, path: YamlPath) -> None:
        for name, value in step.with_.items():
            here, section = (*path, "with", name), part.file.parameters.get(name)
            if section is None:
                known = did_you_mean(name, part.file.parameters) or "; it has none"
                self._report(here, f"unknown parameter '{name}' of scenario '{part.name}'{known}", key=True)
            elif not (isinstance(value, str) and "${" in value) and (wrong := parameter_problem(section, value)):
                self._report(here, wrong)
        for name, section in part.file.parameters.items():
            if section.default is None and name not in step.with_:
                message = f"parameter '{name}' of scenario '{part.name}' has no default: give it under 'with'"
                self._report((*path, "scenario"), message)


def every_step(steps: Iterable[AnyStep]) -> Iterator[AnyStep]:
    """Yield steps and the steps inside them, in the order of the file."""
    for step in steps:
        yield step
        for _, inner in inner_steps(step):
            yield from every_step(inner)


def roles_of(steps: Sequence[AnyStep], path: YamlPath, scenario: Scenario, first: int = 0) -> Iterator[str]:
    """Yield the roles at work in steps, those of the scenarios that they carry out by the names of this scenario.

    Args:
        steps: the steps.
        path: where they stand.
        scenario: the scenario that they belong to.
        first: number of the first of them that counts, from 0.
    """
    for index, step in enumerate(steps[first:], first):
        here = (*path, index)
        if isinstance(step, OnStep):
            yield step.on
        elif isinstance(step, ScenarioStep):
            part = scenario.parts.get(format_path(here))
            for theirs in part.file.roles if part is not None else ():
                yield step.roles.get(theirs, theirs)
        for keys, inner in inner_steps(step) if not isinstance(step, OnStep) else ():
            yield from roles_of(inner, (*here, *keys), scenario)


def _signals_of(scenario: Scenario) -> set[str]:
    """Return the signals that a scenario gives, those among them that its parts give with theirs."""
    given: set[str] = set()
    for step in every_step((*scenario.file.steps, *scenario.file.finally_)):
        if isinstance(step, SignalStep):
            given.add(step.signal)
        elif isinstance(step, ScenarioStep):
            given |= set(step.signals.values())
    return given
