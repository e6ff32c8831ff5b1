"""Limits of expressions: the size of a value, and the work of one expression, of a check and of a run.

The size of a value is the number of its characters and of its values, lists included. The items of a list inside a list
count each time that the list is referenced. Otherwise a few lines such as `b: [a, a, a]`, `c: [b, b, b]` make a value
that fills the memory. An operation of an expression costs the size of its result.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final

from eal_actors.kernel.errors import ScenarioError

MAX_SIZE: Final = 100_000
"""Maximum size of a value, and maximum work of one expression."""
MAX_WORK: Final = 10_000_000
"""Maximum work of the expressions that are evaluated before a run."""
MAX_LEVELS: Final = 40
"""Maximum nesting of lists."""
SCALARS: Final = frozenset({int, float, bool, type(None)})
"""The types of values of size 1."""
_local = threading.local()


class WorkLimitError(ScenarioError):
    """An expression, or all expressions of a check or a run together, would need too much time or memory."""


class WorkBudget:
    """The work that the expressions of a check or a run may do together.

    Args:
        purpose: names the expressions in messages, such as `the expressions of this run`.
        limit: the work at any time.
        earned: returns additional work that is allowed by now.

    Attributes:
        spent: the work so far.
    """

    def __init__(self, purpose: str, limit: int, earned: Callable[[], float] = lambda: 0.0) -> None:
        self.spent = 0
        self._purpose = purpose
        self._limit = limit
        self._earned = earned

    def is_spent(self) -> bool:
        """Return whether no work is left."""
        return self.spent > self._limit + self._earned()

    def message(self) -> str:
        """Return the text of the problem that the budget is spent."""
        return f"up to here, {self._purpose} need more work than {self._limit} items, characters and operations"

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Charge the budget with the expressions that the calling thread evaluates in a `with` block."""
        outer = current_budget()
        _local.budget = self
        try:
            yield
        finally:
            _local.budget = outer


def current_budget() -> WorkBudget | None:
    """Return the budget that the calling thread's expressions are charged to; None without one."""
    return getattr(_local, "budget", None)


def size_of(value: object, limit: int = MAX_SIZE) -> int:
    """Return the size of a value; a number over the limit if it is larger, or nested too deep."""
    if type(value) in SCALARS:
        return 1
    size, level = 0, [value]
    for _ in range(MAX_LEVELS + 1):
        inner: list[Any] = []
        for item in level:
            size += 1
            if type(item) in SCALARS:
                continue
            if isinstance(item, str):
                size += len(item)
            elif isinstance(item, list | tuple | Mapping):
                if size + len(inner) + len(item) > limit:
                    return limit + 1
                inner += item.values() if isinstance(item, Mapping) else item
        if not inner:
            return size
        level = inner
    return limit + 1


def require_small(value: object, what: str) -> None:
    """Check the size of a value.

    Raises:
        WorkLimitError: it is too large.
    """
    if size_of(value) > MAX_SIZE:
        raise WorkLimitError(
            f"{what} has more than {MAX_SIZE} items and characters, or lists nested more than {MAX_LEVELS} levels deep"
        )
