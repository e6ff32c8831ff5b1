"""The values of variables that are known before the run: every combination of the loops around a step."""

from __future__ import annotations

import itertools
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
    """The values known before the run at one step, with the loops from the outermost, and the conditions around it.

    The constants are the parameters and `run`; the facts are empty while a step is checked for many robots at once.
    """

    constants: Mapping[str, object]
    loops: tuple[StaticLoop, ...] = ()
    guards: tuple[Guard, ...] = ()
    facts: Mapping[str, object] = field(default_factory=dict)
    has_facts: bool = False

    def within(self, loop: StaticLoop) -> StaticValues:
        """Return the values inside a loop."""
        return replace(self, loops=(*self.loops, loop))

    def under(self, guard: Guard) -> StaticValues:
        """Return the values in a branch of an `if`."""
        return replace(self, guards=(*self.guards, guard))

    def needs_facts(self, expressions: Iterable[Expression]) -> bool:
        """Return whether expressions, or the conditions and loops around them, differ from robot to robot."""
        _, left = self._closure({name.name for expression in expressions for name in expression.names})
        return self.has_facts and bool(left & ROBOT_FACTS)

    def is_known(self, expression: Expression) -> bool:
        """Return whether the values of an expression are known before the run."""
        return not expression.readings and self._are_known({name.name for name in expression.names})

    def _are_known(self, names: set[str]) -> bool:
        left = set(names)
        for loop in reversed(self.loops):
            if loop.name in left:
                if loop.values is None:
                    return False
                left.discard(loop.name)
                if isinstance(loop.values, Expression):
                    if loop.values.readings:
                        return False
                    left |= {name.name for name in loop.values.names}
        return left <= set(self.constants) | (ROBOT_FACTS if self.has_facts else set())

    def _closure(self, names: set[str]) -> tuple[list[StaticLoop], set[str]]:
        """Return the loops that define names and the conditions around them, outermost first, and the other names.

        An inner loop hides the variable of an outer one.
        """
        left = names | {
            name.name for guard in self.guards if self.is_known(guard.condition) for name in guard.condition.names
        }
        used: list[StaticLoop] = []
        for loop in reversed(self.loops):
            if loop.name in left:
                used.insert(0, loop)
                left = left - {loop.name}
                if isinstance(loop.values, Expression):
                    left |= {name.name for name in loop.values.names}
        return used, left

    def combinations(self, expressions: Iterable[Expression]) -> Iterator[Namespace]:
        """Yield the values of the variables of some expressions, once for each combination that reaches them.

        Raises TooManyCombinationsError if there are more than MAX_COMBINATIONS.
        """
        loops, _ = self._closure({name.name for expression in expressions for name in expression.names})
        used = [loop for loop in loops if loop.values is not None]
        count = 1
        for loop in used:
            count *= 1 if isinstance(loop.values, Expression) else len(loop.values or ())
        if count > MAX_COMBINATIONS:
            raise TooManyCombinationsError(count)
        conditions = [guard for guard in self.guards if self.is_known(guard.condition)]
        found = self._expand(used, {**self.constants, **self.facts})
        for variables in itertools.islice(found, MAX_COMBINATIONS):
            names = Namespace(variables)
            if all(_holds(guard, names) for guard in conditions):
                yield names
        if next(found, None) is not None:
            raise TooManyCombinationsError(MAX_COMBINATIONS + 1)

    def _expand(self, loops: Sequence[StaticLoop], variables: Mapping[str, object]) -> Iterator[dict[str, Any]]:
        if not loops:
            yield dict(variables)
            return
        first, rest = loops[0], loops[1:]
        values = first.values
        if isinstance(values, Expression):
            try:
                values = to_plain(evaluate(values, Namespace(variables)), "the list")
            except ScenarioError:  # reported by the check of the loop itself
                return
        for value in values if isinstance(values, list | tuple | range) else ():
            yield from self._expand(rest, {**variables, first.name: value})


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
