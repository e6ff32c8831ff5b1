"""Which names variables may have, and what is known where a step stands."""

from __future__ import annotations

import keyword
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from eal_actors.kernel.strict_model import did_you_mean
from eal_actors.scenario.expressions.functions import CONSTANTS, FUNCTIONS
from eal_actors.scenario.expressions.grammar import READINGS

ROBOT_FACTS: Final = frozenset({"robot", "role", "index", "count"})
"""What every robot of an `on` knows of itself: its name, its role, its number in it from 0, and how many there are."""
RUN: Final = "run"


class Loop(NamedTuple):
    """A loop's variable, and how many values it takes; None where that is known only during the run."""

    name: str
    passes: int | None
    is_static: bool


@dataclass(frozen=True, slots=True)
class Scope:
    """What is known where a step stands.

    Attributes:
        role: the role of the `on` around it.
        around: the loops around it, from the outermost.
        is_finally: it belongs to `finally`.
        is_beside: others go on beside it, so that it may meet them.
        is_top: it stands at the top level of the file.
    """

    role: str | None = None
    around: tuple[Loop, ...] = ()
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
        """What a robot knows of itself here."""
        return ROBOT_FACTS if self.role is not None else frozenset()

    def within(self, loop: Loop) -> Scope:
        """Return the scope of a loop's steps."""
        return replace(self, around=(*self.around, loop), is_top=False)


def name_problem(name: str) -> str | None:
    """Return why a variable cannot have a name, or None."""
    if name in ROBOT_FACTS or name == RUN:
        return f"'{name}' has a meaning already, and cannot be the name of a variable"
    if name in FUNCTIONS or name in READINGS or name in CONSTANTS:
        return f"'{name}' has a meaning in expressions already, and cannot be the name of a variable"
    if keyword.iskeyword(name):
        return f"'{name}' is a word of the expression language, and cannot be the name of a variable"
    return None


def unknown_variable(name: str, known: Iterable[str]) -> str:
    """Return the message for a variable that nothing brings into scope."""
    names = set(known)
    hint = did_you_mean(name, names) if names else "; no variable is known here"
    return f"unknown variable '{name}'{hint}"
