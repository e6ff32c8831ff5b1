"""The tree of errors: every one can be raised anew for each caller, and none shares its code."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Iterator

import pytest

from eal_actors.kernel import errors
from eal_actors.kernel.errors import ConfigError, EALError, Problem


def tree(kind: type[EALError] = EALError) -> Iterator[type[EALError]]:
    """Yield the errors of `eal_actors.kernel.errors`."""
    for child in kind.__subclasses__():
        if child.__module__ == errors.__name__:
            yield child
            yield from tree(child)


@pytest.mark.parametrize("kind", [kind for kind in tree() if kind is not ConfigError], ids=lambda kind: kind.__name__)
def test_a_copy_says_the_same(kind: type[EALError]) -> None:
    error = kind("the way is blocked", robot="roomba-1", resource="Base")
    other = error.copy()
    assert other is not error
    assert type(other) is kind
    assert str(other) == "roomba-1/Base: the way is blocked"


@pytest.mark.parametrize("copied", [ConfigError.copy, copy.copy, lambda error: pickle.loads(pickle.dumps(error))])  # noqa: S301
def test_a_copy_of_a_configuration_error_keeps_its_problems(copied: Callable[[ConfigError], ConfigError]) -> None:
    problems = [Problem("f.yaml", 2, 1, "robots", "is missing"), Problem("f.yaml", 1, 1, "version", "must be 1")]
    error = ConfigError(problems).at("roomba-1")
    assert copied(error).problems == tuple(sorted(problems))
    assert copied(error).robot == "roomba-1"
    assert str(copied(error)) == str(error)


def test_every_code_stands_for_one_error() -> None:
    codes = [kind.code for kind in tree() if "code" in vars(kind)]
    assert len(codes) == len(set(codes))


def test_the_text_of_an_exception_ends_with_no_colon_without_a_message() -> None:
    class MuteError(Exception):
        def __str__(self) -> str:
            raise RuntimeError

    texts = [errors.error_text(error) for error in (ValueError("no"), MemoryError(), SystemExit(3), MuteError("x"))]
    assert texts == ["ValueError: no", "MemoryError", "SystemExit: 3", "MuteError"]
