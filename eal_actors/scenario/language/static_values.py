"""The values of variables that are known before the run: every combination of the loops around a step."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

from eal_actors.kernel.errors import EALError, ScenarioError
from eal_actors.scenario.language.expressions.evaluation import Namespace, evaluate, expressions_in, render, to_plain
from eal_actors.scenario.language.expressions.grammar import Expression
from eal_actors.scenario.language.scenario import Scenario
from eal_actors.scenario.language.scope import ROBOT_FACTS

MAX_COMBINATIONS: Final = 100_000
"""Maximum combinations of the loops around one step; a step that needs more is a problem."""


class TooManyCombinationsError(Exception):
    """The loops around a step give too many combinations; holds their number, as far as it was counted."""


@dataclass(frozen=True, slots=True)
class StaticLoop:
    """The variable of a loop and its values: a sequence, an expression that gives one, or None if unknown."""

    name: str
    values: Sequence[object] | Expression | None


@dataclass(frozen=True, slots=True)
class Guard:
    """A condition under which a step runs."""

    condition: Expression
    wanted: bool


@dataclass(frozen=True, slots=True)
class StaticValues:
    """The values known before the run at one step, with the loops and conditions around it, from the outermost.

    The constants are the parameters and `run`; the facts are empty while a step is checked for many robots at once.
    """

    constants: Mapping[str, object]
    around: tuple[StaticLoop | Guard, ...] = ()
    facts: Mapping[str, object] = field(default_factory=dict)
    has_facts: bool = False

    def within(self, part: StaticLoop | Guard) -> StaticValues:
        """Return the values inside a loop, or in a branch of an `if`."""
        return replace(self, around=(*self.around, part))

    @property
    def is_in_loop(self) -> bool:
        """Whether a loop is around the step."""
        return any(isinstance(part, StaticLoop) for part in self.around)

    def needs_facts(self, expressions: Iterable[Expression]) -> bool:
        """Return whether expressions, or the conditions and loops around them, differ from robot to robot."""
        _, left = self._closure(expressions)
        return self.has_facts and bool(left & ROBOT_FACTS)

    def is_known(self, expression: Expression) -> bool:
        """Return whether the values of an expression are known before the run."""
        if expression.readings:
            return False
        left = _names_of(expression)
        for part in reversed(self.around):
            if isinstance(part, StaticLoop) and part.name in left:
                if part.values is None or (isinstance(part.values, Expression) and part.values.readings):
                    return False
                left = left - {part.name} | _names_of(part.values)
        return left <= set(self.constants) | (ROBOT_FACTS if self.has_facts else set())

    def _closure(self, expressions: Iterable[Expression]) -> tuple[list[StaticLoop | Guard], set[str]]:
        """Return the loops that define names and the known conditions, outermost first, and the other names.

        An inner loop hides the variable of an outer one; a condition between the two means the outer one.
        """
        left = {name for expression in expressions for name in _names_of(expression)}
        used: list[StaticLoop | Guard] = []
        for index, part in reversed(list(enumerate(self.around))):
            if isinstance(part, StaticLoop):
                if part.name in left:
                    used.insert(0, part)
                    left = left - {part.name} | _names_of(part.values)
            elif replace(self, around=self.around[:index]).is_known(part.condition):
                used.insert(0, part)
                left |= _names_of(part.condition)
        return used, left

    def combinations(self, expressions: Iterable[Expression]) -> Iterator[Namespace]:
        """Yield the values of the variables of some expressions, once for each combination that reaches them.

        Raises TooManyCombinationsError if there are more than MAX_COMBINATIONS.
        """
        used, _ = self._closure(expressions)
        sizes = (
            len(part.values) for part in used if isinstance(part, StaticLoop) and isinstance(part.values, Sequence)
        )
        count = math.prod(sizes)
        if count > MAX_COMBINATIONS:
            raise TooManyCombinationsError(count)
        found = _expand(used, {**self.constants, **self.facts})
        for variables in itertools.islice(found, MAX_COMBINATIONS):
            if variables is not None:
                yield Namespace(variables)
        if next(found, self) is not self:
            raise TooManyCombinationsError(MAX_COMBINATIONS + 1)


def _names_of(values: Sequence[object] | Expression | None) -> set[str]:
    return {name.name for name in values.names} if isinstance(values, Expression) else set()


def _expand(around: Sequence[StaticLoop | Guard], variables: dict[str, Any]) -> Iterator[dict[str, Any] | None]:
    """Yield the variables of each combination; None for those that a condition excludes."""
    if not around:
        yield variables
        return
    first, rest = around[0], around[1:]
    if isinstance(first, Guard):
        if _holds(first, Namespace(variables)):
            yield from _expand(rest, variables)
        else:
            yield None
        return
    values = first.values
    if values is None:  # known only during the run
        yield from _expand(rest, variables)
        return
    if isinstance(values, Expression):
        try:
            values = to_plain(evaluate(values, Namespace(variables)), "the list")
        except ScenarioError:  # reported by the check of the loop itself
            return
    for value in values if isinstance(values, list | tuple | range) else ():
        yield from _expand(rest, {**variables, first.name: value})


def _holds(guard: Guard, names: Namespace) -> bool:
    try:
        return bool(evaluate(guard.condition, names)) == guard.wanted
    except ScenarioError:  # reported by the check of the condition itself
        return False


def value_of_parameters(scenario: Scenario, value: object) -> object:
    """Return a value with its expressions evaluated, if it depends on parameters alone; otherwise None."""
    if any(
        expression.readings or any(name.name not in scenario.parameters for name in expression.names)
        for expression in expressions_in(value)
    ):
        return None
    try:
        return render(value, Namespace({**scenario.parameters, "run": {}}))
    except EALError:
        return None
