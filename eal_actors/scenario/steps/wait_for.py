"""The step `wait_for`: wait for a signal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from typing_extensions import override

from eal_actors.kernel.errors import DeadlineError
from eal_actors.kernel.strict_model import Name
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.engine.action import StepAction
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.expressions.evaluation import render
from eal_actors.scenario.language.scenario import Show
from eal_actors.scenario.language.scope import Scope, ScopeCheck
from eal_actors.scenario.language.values import Count, Held, Value, VariableName
from eal_actors.scenario.steps.base import WaitingStep


class WaitForStep(WaitingStep, kind="wait_for"):
    """Wait for a signal; one that came before counts."""

    holds: ClassVar[Mapping[str, Held]] = {"count": "count", "save_as": "variable", "default": "template"}
    wait_for: Name
    count: Count = 1
    """How often it must have been given since the beginning of the run."""
    save_as: VariableName | None = None
    """Variable for the signal's last value."""
    default: Value | None = None
    """Its value when the time is up; without a default the step fails."""

    @override
    def check_placement(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        super().check_placement(check, path, scope)
        if self.wait_for not in check.signals:
            hint = did_you_mean(self.wait_for, check.signals) or "; the scenario gives no signal"
            check.report((*path, "wait_for"), f"no step gives the signal '{self.wait_for}'{hint}")

    @override
    def words(self, show: Show) -> str:
        times = f" {show(self.count)} times" if self.count != 1 else ""
        default = f", else {show(self.default)}" if self.default is not None else ""
        return f"wait for signal {self.wait_for}{times}, at most {show(self.timeout_s)} s{default}"

    @override
    def attempt(self, action: StepAction) -> Coroutine:
        run, context = action.run, action.context
        count = int((yield from action.number(self.count, "count", "count")))
        timeout_s = yield from action.number(self.timeout_s, "timeout", "timeout_s")
        future = run.signals.wait(context.frame, self.wait_for, count)
        try:
            is_given = yield from run.wait_within(context, future, timeout_s)
        finally:
            run.signals.withdraw(context.frame, self.wait_for, future)
        value: Any
        if is_given:
            value = future.get()
        elif self.default is not None:
            names = yield from action.read(self.default)
            value = render(self.default, names)
        else:
            given = run.signals.counts.get((context.frame, self.wait_for), 0)
            often = f"; it was given {given} of {count} times" if count > 1 else ""
            raise DeadlineError(f"signal '{self.wait_for}' was not given within {timeout_s:g} s{often}")
        run.assign(context, self.save_as, value)
