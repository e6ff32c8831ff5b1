"""The step `wait_until`: poll an expression until it is true."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

from pydantic import PositiveFloat
from typing_extensions import override

from eal_actors.kernel.clock import ROUNDING_S
from eal_actors.kernel.errors import DeadlineError
from eal_actors.scenario.engine.action import StepAction
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.expressions.evaluation import evaluate, parse_bare, to_plain
from eal_actors.scenario.language.scenario import Show
from eal_actors.scenario.language.values import ExpressionText, Held
from eal_actors.scenario.language.wording import describe_names
from eal_actors.scenario.steps.base import WaitingStep

POLL_S: Final = 0.1


class WaitUntilStep(WaitingStep, kind="wait_until"):
    """Wait until an expression is true."""

    holds: ClassVar[Mapping[str, Held]] = {"wait_until": "condition"}
    wait_until: ExpressionText
    """An expression, without `${}`."""
    poll_s: PositiveFloat = POLL_S
    """Time between two evaluations, in seconds of the fleet's clock."""

    @override
    def words(self, show: Show) -> str:
        return f"wait until {self.wait_until}, at most {show(self.timeout_s)} s"

    @override
    def attempt(self, action: StepAction) -> Coroutine:
        run, context = action.run, action.context
        expression, _ = parse_bare(self.wait_until)
        timeout_s = yield from action.number(self.timeout_s, "timeout", "timeout_s")
        end_s = run.pauses.active_s() + timeout_s
        while True:
            names = yield from run.read(context, [expression])
            if to_plain(evaluate(expression, names), self.wait_until):
                return
            left_s = end_s - run.pauses.active_s()
            if left_s <= ROUNDING_S:  # a sleep of less would not advance a clock that jumps
                seen = describe_names(expression, names)
                raise DeadlineError(f"{self.wait_until} did not become true within {timeout_s:g} s{seen}")
            yield from run.sleep(context, min(self.poll_s, left_s))
