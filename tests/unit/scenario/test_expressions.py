from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eal_actors.device.data import EALData
from eal_actors.kernel.errors import ScenarioError
from eal_actors.scenario.language.expressions.evaluation import (
    Namespace,
    evaluate,
    evaluate_bare,
    parse_bare,
    render,
    render_text,
)
from eal_actors.scenario.language.expressions.functions import as_text
from eal_actors.scenario.language.expressions.grammar import RobotReading, parse_expression, parse_template

VARIABLES: dict[str, object] = {
    "n": 45,
    "x": 0.5,
    "yes": True,
    "word": "go",
    "pair": (1, 2),
    "rows": ((1, 2), (3, 4)),
    "read": EALData.of(7),
    "rays": EALData.of(np.array([0.5, 2.0])),
    "answer": {"x": 3},
    "run": {"seed": 9},
}
KNOWN = Namespace(
    VARIABLES,
    {RobotReading("get_value", "Range"): EALData.of([0.5, 2.0]), RobotReading("get_config", "Base", "step_m"): 1},
)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1 + 2 * 3 - 4 / 2", 5.0),
        ("7 // 2 + 7 % 4 + 2 ** 3", 14),
        ("-n + +1", -44),
        ("1 < 2 <= 2 and not 3 != 3", True),
        ("'a' < 'b' and 'x' in 'text' and 3 not in [1, 2]", True),
        ("0 or word", "go"),
        ("'far' if x > 1 else 'near'", "near"),
        ("pair[1] + [5, 6, 7][-1] + len([1, 2, 3][1:])", 11),
        ("answer['x'] + run.seed", 12),
        ("min(3, 1, 2) + max([4, 5]) + abs(-1) + sum([1, 2])", 10),
        ("round(2.567, 1)", 2.6),
        ("round(sin(pi / 2) + cos(0) + sqrt(4) + hypot(3, 4) + tan(0) + atan2(0, 1), 9)", 9.0),
        ("round(degrees(radians(90)), 9)", 90.0),
        ("range(2, 8, 3)", [2, 5]),
        ("repeated(pair, 2)", [1, 2, 1, 2]),
        ("repeated(rows, 0)", []),
        ("rows[1][0] + len(rows) + sum(rows[0])", 8),
        ("rows[1:] + [pair]", [[3, 4], [1, 2]]),
        (
            "[wrap_deg(450), wrap_deg(-190), wrap_deg(180), wrap_deg(-180), wrap_deg(540), wrap_deg(10)]",
            [90, 170, 180, 180, 180, 10],
        ),
        ("floor(2.7) + ceil(2.1) + int('5') + int(2.9)", 12),
        ("float('1.5') + 1", 2.5),
        ("bool(0) or bool([1])", True),
        ("str(45.0) + str(true) + 'x'", "45truex"),
        ("[1] + [2, [3]]", [1, 2, [3]]),
        ("value('Range')[0] + config('Base', 'step_m')", 1.5),
        ("min(rays) + read", 7.5),
        ("None == None", True),
        ("  n  ", 45),
    ],
)
def test_what_comes_of_an_expression(text: str, value: object) -> None:
    assert evaluate(parse_expression(text), KNOWN) == value


@pytest.mark.parametrize(
    ("text", "flaw", "offset"),
    [
        ("", "an expression is missing", 0),
        ("1 +", "'1 +' is not an expression: invalid syntax", 0),
        ("a = 1", "'a = 1' is not an expression: invalid syntax", 2),
        ("x.y", "'.y' is not part of the expression language; items are written with [...]", 0),
        ("1 + x.__class__", "'.__class__' is not part of the expression language; items are written with [...]", 4),
        ("run.sed", "unknown fact of the run 'sed'; did you mean 'seed'?", 0),
        ("squrt(4)", "unknown function 'squrt'; did you mean 'sqrt'?", 0),
        ("sqrt(1, 2)", "sqrt() takes 1 argument, not 2", 0),
        ("hypot(1)", "hypot() takes 2 to 3 arguments, not 1", 0),
        ("max()", "max() takes at least 1, not 0", 0),
        ("round(1, ndigits=2)", "round() takes its arguments without names", 0),
        ("min + 1", "'min' is a function; write min(...)", 0),
        ("(lambda: 1)()", "'lambda: 1' cannot be called", 0),
        ("[i for i in [1]]", "'[i for i in [1]]' is not part of the expression language", 0),
        ("{'a': 1}", "\"{'a': 1}\" is not part of the expression language", 0),
        ("f'{x}'", "\"f'{x}'\" is not part of the expression language", 0),
        ("b'x'", "b'x' is neither a number nor text nor true or false", 0),
        ("1j", "1j is neither a number nor text nor true or false", 0),
        ("x << 2", "'x << 2' is not part of the expression language", 0),
        ("x is 1", "'x is 1' is not part of the expression language", 0),
        ("max(*pair)", "'*pair' is not part of the expression language", 4),
        ("value(word)", "value() takes names in quotes, such as value('Range'); they are checked before the run", 0),
        ("config('Base')", "config() takes 2 texts, such as config('Base', 'step_m')", 0),
        ("1\n+ 2", "must be on one line", 1),
        ("2 + 1e999", "the result is not a finite number", 4),
        ("9" * 100, "the result has more than 256 bits", 0),
        ("1+" * 600 + "1", "is longer than 1000 characters", 0),
        ("-" * 900 + "1", "is nested more than 40 levels deep", 41),
    ],
)
def test_what_is_no_expression(text: str, flaw: str, offset: int) -> None:
    expression = parse_expression(text)
    first = next(found for found in expression.flaws if found.message == flaw)

    assert first.offset == offset or len(text) > 500
    with pytest.raises(ScenarioError):
        evaluate(expression, KNOWN)


@pytest.mark.parametrize("text", ["(" * 400, "[" * 900, "not " * 240 + "1", "1 if 1 else " * 70 + "1", "\0"])
def test_nesting_breaks_nothing(text: str) -> None:
    assert parse_expression(text).flaws


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("2 ** 10 ** 10", "the result has more than 256 bits"),
        ("repeated([1, 2], 5001)", "repeated() gives at most 10000 items"),
        ("repeated([1], 1.5)", "repeated() takes a whole number of times from 0, not 1.5"),
        ("repeated('a', 2)", "repeated() takes a list, not text"),
        ("9 ** 9 ** 9", "the result has more than 256 bits"),
        ("2 ** 255 * 9", "the result has more than 256 bits"),
        ("10.0 ** 400", "10.0 ** 400: the result is too large"),
        ("1e308 * 10", "the result is not a finite number"),
        ("(-1) ** 0.5", "the result is not a real number"),
        ("'a' * 1000000000", "'*' takes numbers, not text"),
        ("'%1000000000d' % 1", "'%' takes numbers, not text"),
        ("range(10 ** 9)", "range() gives at most 10000 items"),
        ("range(1e9)", "range() takes whole numbers, not 1000000000.0"),
        ("range(1, 5, 0)", "range() arg 3 must not be zero"),
        ("round(5, -1000000000)", "round() takes a number of digits from -20 to 20"),
        ("range(9000) + range(9000)", "the result has more than 10000 items"),
        ("1 / 0", "a division by zero"),
        ("[1][3]", "the list or text has no such item"),
        ("answer['y']", "'y'"),
        ("'a' + 1", "'+' takes two numbers, two texts or two lists, not text and a number"),
        ("1 < 'a'", "'<' takes numbers, not text"),
        ("len(5)", "len() takes a list or a text, not a number"),
        ("min([])", "min() of an empty list has no value"),
        ("int('x')", "'x' is no whole number"),
        ("int(1e300)", "the result has more than 256 bits"),
        ("round(1e300)", "the result has more than 256 bits"),
        ("sqrt(-1)", "sqrt(-1): "),  # the words are those of Python, whose versions differ
        ("gone + 1", "the variable 'gone' has no value: the step that gives it one did not succeed"),
    ],
)
def test_what_cannot_be_worked_out(text: str, message: str) -> None:
    start_s = time.process_time()
    with pytest.raises(ScenarioError) as caught:
        evaluate(parse_expression(text), KNOWN)

    assert message in caught.value.message
    assert time.process_time() - start_s < 0.5


def test_large_arrays_are_no_numbers() -> None:
    known = Namespace({"frame": EALData.of(np.zeros((200, 200, 3), dtype=np.uint8))})

    assert evaluate(parse_expression("frame"), known) is known.variables["frame"], "alone it is only passed on"
    with pytest.raises(ScenarioError, match="the variable 'frame' has more than 10000 elements"):
        evaluate(parse_expression("frame[0]"), known)


def test_what_an_expression_needs_is_known() -> None:
    expression = parse_expression("a + value('Range') * b - a + request('Base', 'q')")

    assert [(name.name, name.offset) for name in expression.names] == [("a", 0), ("b", 21)]
    assert expression.readings == ((RobotReading("get_value", "Range"), 4), (RobotReading("send_req", "Base", "q"), 29))
    assert str(expression.readings[1][0]) == "request('Base', 'q')"
    assert parse_expression("'é' + missing").names[0].offset == 6, "characters are counted, not bytes"


@given(st.text(max_size=80))
@settings(max_examples=300, deadline=None)
def test_no_text_breaks_the_reader(text: str) -> None:
    expression = parse_expression(text)
    if not expression.flaws:
        try:
            evaluate(expression, KNOWN)
        except ScenarioError:
            return


# Templates.


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("${n}", 45),
        ("${n + 1}", 46),
        ("${x}", 0.5),
        ("${yes}", True),
        ("${pair}", (1, 2)),
        ("r${n}", "r45"),
        ("r${n * 1.0}", "r45"),
        ("f${x / 100000000}", "f0.000000005"),
        ("${word} ${x} ${yes}", "go 0.5 true"),
        ("read ${read}", "read 7"),
        ("${'}' + '{'}", "}{"),
        (r"${'\\'} and ${'\'}'}", r"\ and '}"),
        ("$${n}", "${n}"),
        ("$${n} ${n}", "${n} 45"),
        ("plain $ {n}", "plain $ {n}"),
        (5, 5),
        (True, True),
        (("${n}", "a${n}", 3), (45, "a45", 3)),
    ],
)
def test_expressions_are_put_in(value: object, expected: object) -> None:
    result = render(value, KNOWN)

    assert (type(result), result) == (type(expected), expected)


def test_an_answer_keeps_its_type() -> None:
    assert render("${read}", KNOWN) is VARIABLES["read"]


def test_a_text_stays_text() -> None:
    assert render_text("${n}", KNOWN) == "45"
    assert render_text("$${n}", KNOWN) == "${n}"


@pytest.mark.parametrize("text", ["${", "${a", "x ${'}"])
def test_a_broken_reference_is_told(text: str) -> None:
    (flaw,) = parse_template(text).flaws

    assert flaw == ("${ must be closed, as in ${expression}; write $${ for a literal ${", text.index("${"))


@pytest.mark.parametrize("value", [(1, 2), EALData.of(np.zeros(2)), None])
def test_what_is_no_text_cannot_stand_in_one(value: object) -> None:
    with pytest.raises(ScenarioError, match=r"\$\{v\} is of type .*, which has no form in a text"):
        render("a${v}", Namespace({"v": value}))


@pytest.mark.parametrize(
    ("value", "expected"),
    [("n + 1", 46), ("${n + 1}", 46), (["n", "'a'", 3], [45, "a", 3]), (3, 3), (True, True)],
)
def test_expressions_by_themselves(value: Any, expected: object) -> None:
    assert evaluate_bare(value, KNOWN) == expected
    assert parse_bare("${n}")[1] == 2


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (45.0, "45"),
        (0.1, "0.1"),
        (1e-7, "0.0000001"),
        (1e20, "100000000000000000000"),
        (0.1 + 0.7, "0.8"),
        (1.1 * 3, "3.3"),
        (1 / 3, "0.333333333333333"),
        (True, "true"),
        (-3, "-3"),
        (-0.0, "0"),
        (2.5, "2.5"),
    ],
)
def test_numbers_as_commands_want_them(number: float, text: str) -> None:
    assert as_text(number) == text
