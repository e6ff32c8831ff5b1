"""The tree of errors: every one can be raised anew for each caller, and none shares its code."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from eal_actors import errors
from eal_actors.errors import ConfigError, EALError, Problem


def tree(kind: type[EALError] = EALError) -> Iterator[type[EALError]]:
    """Yield the errors of `eal_actors.errors`."""
    for child in kind.__subclasses__():
        if child.__module__ == errors.__name__:
            yield child
            yield from tree(child)


@pytest.mark.parametrize("kind", [kind for kind in tree() if kind is not ConfigError], ids=lambda kind: kind.__name__)
def test_a_copy_says_the_same(kind: type[EALError]) -> None:
    error = kind("the way is blocked", robot="roomba-1", resource="Base")
    copy = error.copy()
    assert copy is not error
    assert type(copy) is kind
    assert str(copy) == "roomba-1/Base: the way is blocked"


def test_a_copy_of_a_configuration_error_keeps_its_problems() -> None:
    problems = [Problem("f.yaml", 2, 1, "robots", "is missing"), Problem("f.yaml", 1, 1, "version", "must be 1")]
    copy = ConfigError(problems).at("roomba-1").copy()
    assert copy.problems == tuple(sorted(problems))
    assert copy.robot == "roomba-1"


def test_every_code_stands_for_one_error() -> None:
    codes = [kind.code for kind in tree() if "code" in vars(kind)]
    assert len(codes) == len(set(codes))
