from __future__ import annotations

import numpy as np
import pytest

from eal_actors.data import EALData
from eal_actors.errors import ScenarioError
from eal_actors.scenario.variables import names_in, substitute, substitute_text, unknown_variable

VARIABLES = {"n": 45, "x": 0.5, "yes": True, "word": "go", "pair": (1, 2), "read": EALData.of(7)}


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("${n}", 45),
        ("${x}", 0.5),
        ("${yes}", True),
        ("${pair}", (1, 2)),
        ("r${n}", "r45"),
        ("${word} ${x} ${yes}", "go 0.5 true"),
        ("read ${read}", "read 7"),
        ("$${n}", "${n}"),
        ("$${n} ${n}", "${n} 45"),
        ("plain $ {n}", "plain $ {n}"),
        (5, 5),
        (True, True),
        (("${n}", "a${n}", 3), (45, "a45", 3)),
    ],
)
def test_variables_are_put_in(value: object, expected: object) -> None:
    result = substitute(value, VARIABLES)

    assert (type(result), result) == (type(expected), expected)


def test_an_answer_keeps_its_type() -> None:
    assert substitute("${read}", VARIABLES) is VARIABLES["read"]


def test_a_text_stays_text() -> None:
    assert substitute_text("${n}", VARIABLES) == "45"
    assert substitute_text("$${n}", VARIABLES) == "${n}"


@pytest.mark.parametrize(
    ("value", "names"),
    [("${a} ${b} ${a}", ["a", "b"]), ("$${a}", []), (("${a}", 1, "${b}"), ["a", "b"]), (5, []), (None, [])],
)
def test_names_are_found(value: object, names: list[str]) -> None:
    assert names_in(value) == names


@pytest.mark.parametrize("text", ["${", "${1}", "${a b}", "${a", "x ${}"])
def test_a_broken_reference_is_refused(text: str) -> None:
    with pytest.raises(ScenarioError, match=r"^\$\{ must go on as \$\{name\}; write \$\$\{ for a literal \$\{$"):
        names_in(text)


def test_a_variable_without_value_is_named() -> None:
    with pytest.raises(ScenarioError, match="the variable 'gone' has no value"):
        substitute("a${gone}", VARIABLES)


@pytest.mark.parametrize("value", [(1, 2), EALData.of(np.zeros(2)), None])
def test_what_is_no_text_cannot_stand_in_one(value: object) -> None:
    with pytest.raises(ScenarioError, match=r"the variable 'v' is of type .*, which cannot stand in a text"):
        substitute("a${v}", {"v": value})


def test_an_unknown_variable_gets_a_hint() -> None:
    assert unknown_variable("mvoe", ["move"]) == "unknown variable 'mvoe'; did you mean 'move'?"
    assert unknown_variable("mvoe", []) == "unknown variable 'mvoe'; no variable is known here"
