"""The problems of a file, as a value to compare."""

from __future__ import annotations

from collections.abc import Callable

from eal_actors.kernel.errors import ConfigError, Problem


def problems_of(read: Callable[[], object]) -> tuple[Problem, ...]:
    """Return the problems with which reading a file fails; none if it does not."""
    try:
        read()
    except ConfigError as error:
        return error.problems
    return ()


def problem_texts(read: Callable[[], object]) -> list[str]:
    """Return the same as texts."""
    return [str(problem) for problem in problems_of(read)]
