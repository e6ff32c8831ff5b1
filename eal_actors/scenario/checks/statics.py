"""Which values variables take that are known before the run: every combination of the loops around a step."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

from eal_actors.kernel.errors import ScenarioError
from eal_actors.scenario.checks.names import ROBOT_FACTS
from eal_actors.scenario.expressions import Expression, Known, evaluate
from eal_actors.scenario.expressions.evaluation import plain

MAX_COMBINATIONS: Final = 100_000
"""How many values of the loops around a step are tried; a step that needs more is a problem."""


MAX_IN_ALL: Final = 200_000
"""How many are tried for all steps of a scenario together."""


class TooManyCombinationsError(Exception):
    """The loops around a step give more combinations than can be tried; holds how many, as far as was counted."""


@dataclass(frozen=True, slots=True)
class StaticLoop:
    """A loop's variable, and the values it takes: a sequence, an expression that gives it, or None where unknown."""

    name: str
    values: Sequence[object] | Expression | None


@dataclass(frozen=True, slots=True)
class Guard:
    """A condition under which a step is reached."""

    condition: Expression
    wanted: bool


@dataclass(frozen=True, slots=True)
class Statics:
    """What is known before the run where a step stands.

    Attributes:
        constants: the parameters and `run`.
        loops: the loops around it, from the outermost.
        guards: the conditions around it.
        facts: what the robot knows of itself; empty where a step is looked at for many robots at once.
        has_facts: whether it stands inside an `on`.
    """

    constants: Mapping[str, object]
    loops: tuple[StaticLoop, ...] = ()
    guards: tuple[Guard, ...] = ()
    facts: Mapping[str, object] = field(default_factory=dict)
    has_facts: bool = False

    def within(self, loop: StaticLoop) -> Statics:
        """Return what is known inside a loop."""
        return replace(self, loops=(*self.loops, loop))

    def under(self, guard: Guard) -> Statics:
        """Return what is known in a branch of an `if`."""
        return replace(self, guards=(*self.guards, guard))

    def needs_facts(self, expressions: Iterable[Expression]) -> bool:
        """Return whether expressions, or the conditions and loops around them, differ from robot to robot."""
        _, left = self._closure({name.name for expression in expressions for name in expression.names})
        return self.has_facts and bool(left & ROBOT_FACTS)

    def is_known(self, expression: Expression) -> bool:
        """Return whether an expression has its values before the run."""
        return not expression.readings and self._is_known({name.name for name in expression.names})

    def _is_known(self, names: set[str]) -> bool:
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
        allowed = set(self.constants) | (ROBOT_FACTS if self.has_facts else set())
        return left <= allowed

    def _closure(self, names: set[str]) -> tuple[list[StaticLoop], set[str]]:
        """Return the loops that names and the conditions around them mean, from the outermost, and what else is needed.

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

    def combinations(self, expressions: Iterable[Expression]) -> Iterator[Known]:
        """Yield what the variables of some expressions stand for, once for each combination that reaches them.

        Raises:
            TooManyCombinationsError: there are more than can be tried.
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
            known = Known(variables)
            if all(_holds(guard, known) for guard in conditions):
                yield known
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
                values = plain(evaluate(values, Known(variables)), "the list")
            except ScenarioError:  # reported where the loop itself is checked
                return
        for value in values if isinstance(values, list | tuple | range) else ():
            yield from self._expand(rest, {**variables, first.name: value})


def _holds(guard: Guard, known: Known) -> bool:
    try:
        return bool(evaluate(guard.condition, known)) == guard.wanted
    except ScenarioError:  # reported where the condition itself is checked
        return False
