"""Expressions are bounded in size and work, each by itself, and those of a thread together."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from eal_actors.device.data import EALData
from eal_actors.scenario.language.expressions.evaluation import (
    MAX_LEVELS,
    MAX_SIZE,
    Namespace,
    WorkBudget,
    WorkLimitError,
    evaluate,
    evaluate_bare,
    render,
    render_text,
    size_of,
)
from eal_actors.scenario.language.expressions.grammar import parse_expression


def nested(levels: int) -> list[Any]:
    value: list[Any] = []
    for _ in range(levels - 1):
        value = [value]
    return value


@pytest.mark.parametrize(
    ("value", "size"),
    [
        (7, 1),
        (None, 1),
        ("", 1),
        ("four", 5),
        ([], 1),
        ([1, [2, 3]], 5),
        ((1.5, "ab"), 5),
        ({"a": [1, 2]}, 4),
        (EALData.of([1.0, 2.0]), 1),
        (nested(MAX_LEVELS), MAX_LEVELS),
    ],
)
def test_the_size_of_a_value(value: object, size: int) -> None:
    assert size_of(value) == size


@pytest.mark.parametrize("value", [[0] * MAX_SIZE, "x" * MAX_SIZE, nested(MAX_LEVELS + 2), [[0] * 400] * 400])
def test_a_size_over_the_limit_is_not_counted_to_the_end(value: object) -> None:
    assert size_of(value) > MAX_SIZE


def test_a_few_shared_lists_of_lists_are_not_counted_one_by_one() -> None:
    value: list[Any] = [0]
    for _ in range(30):
        value = [value] * 1000
    assert size_of(value) > MAX_SIZE


@pytest.mark.parametrize(
    "text",
    [
        f"[{', '.join(['range(9999)'] * 6)}]",
        f"[{', '.join(['a'] * 6)}]",
        f"{' + '.join(['len(a)'] * 20)}",
        "[deep, 1]",
        "wide[0]",
    ],
)
def test_one_expression_cannot_do_more_than_its_share(text: str) -> None:
    names = Namespace({"a": list(range(9999)), "deep": nested(50), "wide": [[0] * 400] * 400})
    with pytest.raises(WorkLimitError):
        evaluate(parse_expression(text), names)


def test_lists_and_texts_of_several_expressions_are_bounded_together() -> None:
    names = Namespace({"a": list(range(9999)), "t": "x" * 9999})
    with pytest.raises(WorkLimitError, match="the list has more than 100000 items and characters"):
        evaluate_bare(["a"] * 11, names)
    with pytest.raises(WorkLimitError, match="the list has more"):
        render(("${a}",) * 11, names)
    with pytest.raises(WorkLimitError, match="the text has more"):
        render_text("${t}" * 11, names)
    assert len(evaluate_bare(["a"] * 9, names)) == 9


def test_a_budget_counts_what_its_thread_evaluates_and_refuses_when_it_is_spent() -> None:
    budget, earned, names = WorkBudget("these expressions", 1000, lambda: earned_now), 0, Namespace({})
    earned_now = earned
    text = parse_expression("len(range(300))")
    with budget.applied():
        for _ in range(4):
            evaluate(text, names)
        with pytest.raises(WorkLimitError, match="these expressions need more work than 1000 items"):
            evaluate(text, names)
        earned_now = 500
        evaluate(text, names)
        other = threading.Thread(target=evaluate, args=(text, names))
        before = budget.spent
        other.start()
        other.join()
        assert budget.spent == before > 1000
    evaluate(text, names)
    assert budget.spent == before
