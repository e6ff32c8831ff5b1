"""The values that blocks compute before their steps run: conditions, counts and lists."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from functools import partial
from typing import Any

from eal_actors.actors.future import Future
from eal_actors.scenario.engine.action import StepAction
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.executor import perform_step
from eal_actors.scenario.engine.frames import ExecutionContext
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.expressions.evaluation import Namespace, expressions_in, render
from eal_actors.scenario.language.expressions.grammar import Expression
from eal_actors.scenario.language.scenario import FallibleModel
from eal_actors.scenario.language.values import checked_number


def compute(
    run: RunContext,
    context: ExecutionContext,
    step: FallibleModel,
    path: str,
    label: str,
    expressions: Iterable[Expression],
    work: Callable[[Namespace], Any],
) -> Generator[Future[Any], None, Any]:
    """Return a value that a block needs, or None if that failed and the policy was applied.

    `work` computes it from the namespace of the expressions; `path` is that of the value, `label` for people.
    """
    needed = list(expressions)
    found: list[Any] = [None]

    def attempt(action: StepAction) -> Coroutine:
        found[0] = None
        names = yield from action.evaluate(needed)
        found[0] = work(names)

    yield from perform_step(run, context, step, path, partial(StepAction, run, context, label, attempt), is_quiet=True)
    return found[0]


def compute_count(
    run: RunContext, context: ExecutionContext, step: FallibleModel, path: str, value: int | str, key: str
) -> Generator[Future[Any], None, int | None]:
    """Return a whole number that may be an expression; see `compute`."""
    if isinstance(value, int):
        return value

    def work(names: Namespace) -> int:
        return int(checked_number(render(value, names), "count", key))

    found: int | None = yield from compute(
        run, context, step, f"{path}.{key}", f"{key} {value}", expressions_in(value), work
    )
    return found
