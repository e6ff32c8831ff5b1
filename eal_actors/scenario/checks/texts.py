"""Checks the expressions in the values of a scenario: their form, and the variables and readings that they need."""

from __future__ import annotations

from eal_actors.kernel.errors import Problem
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.checks.names import RUN, Scope, name_problem, unknown_variable
from eal_actors.scenario.expressions import Expression, expressions_in, parse_bare, parse_template
from eal_actors.scenario.scenario import Scenario


class Texts:
    """Checks texts one by one, in the order in which their steps run.

    Attributes:
        saved: the variables to which earlier steps give a value, by role.
        constants: the parameters, whose values are known before the run.
    """

    def __init__(self, scenario: Scenario, problems: list[Problem]) -> None:
        self.saved: dict[str | None, set[str]] = {}
        self.constants = frozenset(scenario.file.parameters)
        self._scenario = scenario
        self._problems = problems

    def value(self, value: object, path: YamlPath, scope: Scope, *, static: str = "") -> None:
        """Check the `${...}` in a value, item by item where it is a list.

        Args:
            value: the value.
            path: where it stands.
            scope: what is known there.
            static: what the value is, where it must be known before the run.
        """
        if isinstance(value, tuple | list):
            for index, item in enumerate(value):
                self.value(item, (*path, index), scope, static=static)
        elif isinstance(value, str) and "${" in value:
            template = parse_template(value)
            for flaw in template.flaws:
                self._report(path, flaw.message, value, flaw.offset)
            for expression, offset in template.expressions():
                self._needs(expression, path, scope, value, offset, static)

    def bare(self, value: object, path: YamlPath, scope: Scope) -> None:
        """Check a value that is an expression by itself, or a list of them."""
        if isinstance(value, tuple | list):
            for index, item in enumerate(value):
                self.bare(item, (*path, index), scope)
        elif isinstance(value, str):
            expression, offset = parse_bare(value)
            for flaw in expression.flaws:
                self._report(path, flaw.message, value, offset + flaw.offset)
            self._needs(expression, path, scope, value, offset, "", is_bare=True)

    def assign(self, name: str | None, path: YamlPath, scope: Scope, *, key: bool = False) -> None:
        """Check the name of a variable that a step gives a value, and note it for the steps that follow."""
        if name is None:
            return
        self.check_name(name, path, key=key)
        if name in scope.loops:
            self._problem(path, f"'{name}' is the variable of a loop around this step", key=key)
        elif name in self.constants:
            self._problem(path, f"'{name}' is a parameter, whose value does not change", key=key)
        elif scope.role is not None and name in self.saved.get(None, ()):
            self._problem(path, f"'{name}' is a variable of the run; inside an 'on' it cannot be changed", key=key)
        self.saved.setdefault(scope.role, set()).add(name)

    def check_name(self, name: str, path: YamlPath, *, key: bool = False) -> None:
        """Refuse a name that has a meaning already."""
        if (wrong := name_problem(name)) is not None:
            self._problem(path, wrong, key=key)

    def is_static(self, value: object, scope: Scope) -> bool:
        """Return whether a value is known before the run."""
        known = scope.static_loops | self.constants | scope.facts | {RUN}
        return all(
            not expression.readings and all(name.name in known for name in expression.names)
            for expression in expressions_in(value)
        )

    def _known(self, scope: Scope) -> frozenset[str]:
        saved = self.saved.get(None, set()) | self.saved.get(scope.role, set())
        return scope.loops | self.constants | scope.facts | saved

    def _needs(
        self,
        expression: Expression,
        path: YamlPath,
        scope: Scope,
        text: str,
        offset: int,
        static: str,
        *,
        is_bare: bool = False,
    ) -> None:
        known = self._known(scope)
        for name in expression.names:
            if name.name not in known:
                message = unknown_variable(name.name, known)
                if is_bare and expression.text.strip() == name.name:
                    message += f"; a text stands in quotes of its own: \"'{name.name}'\""
                self._report(path, message, text, offset + name.offset)
        unsure = [
            name for name in expression.names if name.name in known - scope.facts - self.constants - scope.static_loops
        ]
        if static and unsure:
            message = f"{static} must be known before the run, and '{unsure[0].name}' is saved during it"
            self._report(path, message, text, offset + unsure[0].offset)
        for reading, at in expression.readings:
            if static:
                self._report(path, f"{static} must be known before the run, and {reading} is not", text, offset + at)
            elif scope.role is None:
                message = f"{reading} asks a robot, so it must stand in the 'do' of an 'on'"
                self._report(path, message, text, offset + at)

    def _report(self, path: YamlPath, message: str, text: str, offset: int) -> None:
        self._problems.append(self._scenario.problem(path, message, inside=(text, offset)))

    def _problem(self, path: YamlPath, message: str, *, key: bool) -> None:
        self._problems.append(self._scenario.problem(path, message, key=key))
