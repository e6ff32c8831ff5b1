"""The checks of a scenario that need no fleet: names, expressions, and the placement of steps.

Each step kind checks its own fields. This module walks through the steps and holds what they have in common: the
variables in scope, the signals of the scenario, and the list of problems.
"""

from __future__ import annotations

import keyword
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from eal_actors.kernel.errors import EALError, Problem
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.language.expressions.evaluation import (
    MAX_WORK,
    LocatedExpression,
    Namespace,
    WorkBudget,
    evaluate,
    expressions_in,
    locate_expressions,
)
from eal_actors.scenario.language.expressions.functions import CONSTANTS, FUNCTIONS
from eal_actors.scenario.language.expressions.grammar import READINGS, parse_template
from eal_actors.scenario.language.parameters import unit_problem
from eal_actors.scenario.language.scenario import Scenario, Step
from eal_actors.scenario.language.values import OnFailure, final_action

ROBOT_FACTS: Final = frozenset({"robot", "role", "index", "count"})
"""Variables of every robot in an `on`: its name, its role, its number in it from 0, and their number."""
RUN: Final = "run"


class LoopVariable(NamedTuple):
    """The variable of a loop, and its number of values; None if that is known only during the run."""

    name: str
    passes: int | None
    is_static: bool


@dataclass(frozen=True, slots=True)
class Scope:
    """The surroundings of a step, with the loops from the outermost.

    If it `is_beside` others, it can meet them; if it `is_top`, it is at the top level of the file.
    """

    role: str | None = None
    around: tuple[LoopVariable, ...] = ()
    is_finally: bool = False
    is_beside: bool = False
    is_top: bool = True

    @property
    def loops(self) -> frozenset[str]:
        """The variables of the loops."""
        return frozenset(loop.name for loop in self.around)

    @property
    def static_loops(self) -> frozenset[str]:
        """Those whose values are known before the run."""
        return self.loops - {loop.name for loop in self.around if not loop.is_static}

    @property
    def facts(self) -> frozenset[str]:
        """The variables of the robot."""
        return ROBOT_FACTS if self.role is not None else frozenset()

    def inside(self) -> Scope:
        """Return the scope of the steps of a block."""
        return replace(self, is_top=False)

    def within(self, loop: LoopVariable) -> Scope:
        """Return the scope of the steps of a loop."""
        return replace(self, around=(*self.around, loop), is_top=False)


def check_scope(scenario: Scenario, doubtful: Iterable[str] = ()) -> list[Problem]:
    """Return the problems of a scenario that do not depend on the fleet.

    Doubtful names may be variables, signals or roles, because parts of the file could not be read.
    """
    check = ScopeCheck(scenario, frozenset(doubtful))
    for name in scenario.file.parameters:
        check.variable_name(name, ("parameters", name), key=True)
    check.roles()
    check.visit_all(scenario.file.steps, ("steps",), Scope())
    check.saved = {}  # `finally` must not depend on how far the steps came
    check.visit_all(scenario.file.finally_, ("finally",), Scope(is_finally=True))
    return check.problems


def signals_of(scenario: Scenario) -> set[str]:
    """Return the signals that a scenario gives, those that its parts forward to it included."""
    return {signal for _, step in scenario.file.walk() for signal in step.given_signals()}


class ScopeCheck:
    """A walk through the steps in the order in which they run.

    `saved` are the variables that earlier steps assign, by role; `constants` are the parameters, known before the run.
    """

    def __init__(self, scenario: Scenario, doubtful: frozenset[str] = frozenset()) -> None:
        self.scenario = scenario
        self._doubtful = doubtful
        self.problems: list[Problem] = []
        self.saved: dict[str | None, set[str]] = {}
        self.constants = frozenset(scenario.file.parameters)
        self.signals = signals_of(scenario) | doubtful
        self._budget = WorkBudget("the expressions of this file", MAX_WORK)

    def report(self, path: YamlPath, message: str, *, key: bool = False, inside: tuple[str, int] | None = None) -> None:
        """Add a problem; see `Scenario.problem`."""
        self.problems.append(self.scenario.problem(path, message, key=key, inside=inside))

    def visit_all(self, steps: Sequence[Step], path: YamlPath, scope: Scope) -> None:
        """Check steps that follow each other."""
        for index, step in enumerate(steps):
            step.check(self, (*path, index), scope)

    # Roles, signals and units.

    def roles(self) -> None:
        """Check the declarations of the roles."""
        file = self.scenario.file
        if not file.roles and not self._doubtful:
            self.report((), "no robots take part: give the scenario 'roles', or an 'on' the name of a robot")
        for name, role in file.roles.items():
            if role.max is not None and role.max < role.min:
                self.report(("roles", name, "max"), f"is below 'min', {role.min}")
            if role.on_failure is not None:
                self.spares(role.on_failure, ("roles", name, "on_failure"), [name])
        self.spares(file.on_failure, ("on_failure",), file.roles)

    def spares(self, policy: OnFailure, path: YamlPath, roles: Iterable[str]) -> None:
        """Check that a policy which substitutes robots finds spares in one of these roles."""
        declared = self.scenario.file.roles
        if final_action(policy) == "substitute" and not any(
            declared[role].spares for role in roles if role in declared
        ):
            words = " or ".join(f"'{role}'" for role in roles)
            self.report(path, f"no spare can take a robot's place: give role {words} 'spares: 1'", key=True)

    def until(self, until: str, path: YamlPath) -> None:
        """Check the `until` of a block."""
        if until not in ("all", "first") and until not in self.signals:
            known = {"all", "first", *self.signals}
            self.report((*path, "until"), f"must be all, first or a signal, not '{until}'{did_you_mean(until, known)}")

    def unit(self, value: object, path: YamlPath, wanted: str | None, what: str) -> None:
        """Check the unit of a value, as far as it is known."""
        if (wrong := unit_problem(value, self.scenario.file, wanted, what)) is not None:
            self.report(path, wrong)

    # Expressions.

    def template(self, value: object, path: YamlPath, scope: Scope, *, static: str = "") -> None:
        """Check the `${...}` in a value, or in its items; `static` names one that must be known before the run."""
        if isinstance(value, tuple | list):
            for index, item in enumerate(value):
                self.template(item, (*path, index), scope, static=static)
        elif isinstance(value, str) and "${" in value:
            for flaw in parse_template(value).flaws:
                self.report(path, flaw.message, inside=(value, flaw.offset))
            for located in locate_expressions(path, value):
                self._examine(located, scope, static)

    def expression(self, value: object, path: YamlPath, scope: Scope) -> None:
        """Check a value that is an expression without `${}`, or a list of them."""
        if isinstance(value, tuple | list):
            for index, item in enumerate(value):
                self.expression(item, (*path, index), scope)
        elif isinstance(value, str):
            for located in locate_expressions(path, value, is_bare=True):
                for flaw in located.expression.flaws:
                    self._report_at(located, flaw.offset, flaw.message)
                self._examine(located, scope, is_bare=True)

    def _report_at(self, located: LocatedExpression, offset: int, message: str) -> None:
        self.report(located.keys, message, inside=(located.text, located.offset + offset))

    def _examine(self, located: LocatedExpression, scope: Scope, static: str = "", *, is_bare: bool = False) -> None:
        self._variables(located, scope, static, is_bare=is_bare)
        for reading, offset in located.expression.readings:
            if static:
                message = f"{static} must be known before the run, and {reading} is not"
                self._report_at(located, offset, message)
            elif scope.role is None:
                message = f"{reading} reads from a robot, so it must be in the 'do' of an 'on'"
                self._report_at(located, offset, message)
        self._constant(located)

    def _constant(self, located: LocatedExpression) -> None:
        """Check that an expression without variables has a value."""
        expression = located.expression
        if expression.flaws or not expression.is_constant or self._budget.is_spent():
            return
        try:
            with self._budget.applied():
                evaluate(expression, Namespace({}))
        except EALError as error:
            self._report_at(located, 0, error.message)
        if self._budget.is_spent():
            self._report_at(located, 0, self._budget.message())

    def _variables(self, located: LocatedExpression, scope: Scope, static: str, *, is_bare: bool) -> None:
        expression = located.expression
        saved = self.saved.get(None, set()) | self.saved.get(scope.role, set())
        known = scope.loops | self.constants | scope.facts | saved
        for name in expression.names:
            if name.name not in known and name.name not in self._doubtful:
                hint = did_you_mean(name.name, known) if known else "; no variable is known here"
                message = f"unknown variable '{name.name}'{hint}"
                if is_bare and expression.text.strip() == name.name:
                    message += f"; a text needs quotes of its own: \"'{name.name}'\""
                self._report_at(located, name.offset, message)
        unsure = [
            name for name in expression.names if name.name in known - scope.facts - self.constants - scope.static_loops
        ]
        if static and unsure:
            message = f"{static} must be known before the run, and '{unsure[0].name}' is assigned during it"
            self._report_at(located, unsure[0].offset, message)

    def is_static(self, value: object, scope: Scope) -> bool:
        """Return whether a value is known before the run."""
        known = scope.static_loops | self.constants | scope.facts | {RUN}
        return all(
            not expression.readings and all(name.name in known for name in expression.names)
            for expression in expressions_in(value)
        )

    # Variables.

    def assign(self, name: str | None, path: YamlPath, scope: Scope, *, key: bool = False) -> None:
        """Check the name of a variable that a step assigns, and add it to the scope of the steps that follow."""
        if name is None:
            return
        self.variable_name(name, path, key=key)
        if name in scope.loops:
            self.report(path, f"'{name}' is the variable of a loop around this step", key=key)
        elif name in self.constants:
            self.report(path, f"'{name}' is a parameter, whose value does not change", key=key)
        elif scope.role is not None and name in self.saved.get(None, ()):
            self.report(path, f"'{name}' is a variable of the run; inside an 'on' it cannot be changed", key=key)
        self.saved.setdefault(scope.role, set()).add(name)

    def variable_name(self, name: str, path: YamlPath, *, key: bool = False) -> None:
        """Refuse the name of a variable that has another meaning."""
        if name in ROBOT_FACTS or name == RUN:
            meaning = "is a built-in name"
        elif name in FUNCTIONS or name in READINGS or name in CONSTANTS:
            meaning = "is a built-in name of expressions"
        elif keyword.iskeyword(name):
            meaning = "is a keyword of expressions"
        else:
            return
        self.report(path, f"'{name}' {meaning}, and cannot be the name of a variable", key=key)
