"""The steps that wait: `barrier`, `wait_for`, `wait_s` and `wait_until`."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from typing import Any, Final

from pydantic import PositiveFloat
from typing_extensions import override

from eal_actors.kernel.errors import DeadlineError
from eal_actors.kernel.strict_model import Name, did_you_mean
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.engine.executor import StepAction
from eal_actors.scenario.engine.frames import Frame
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.expressions import evaluate, parse_bare, render, to_plain
from eal_actors.scenario.language.scope import Scope, ScopeCheck
from eal_actors.scenario.language.values import Count, ExpressionText, Seconds, Value, VariableName, Wanted
from eal_actors.scenario.steps.base import FallibleStep, Keys, Show, WaitingStep
from eal_actors.scenario.steps.wording import describe_names, short_number


class BarrierStep(WaitingStep):
    """Wait for all robots and branches that have a barrier of this name."""

    kind = "barrier"
    barrier: Name

    @override
    def meeting(self, frame: Frame) -> Hashable:
        return frame, self.barrier

    @override
    def check_placement(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        super().check_placement(check, path, scope)
        if not scope.is_beside:
            message = "a barrier must be inside an 'on' or a 'parallel'"
            check.report((*path, "barrier"), message, key=True)

    @override
    def words(self, show: Show) -> str:
        return f"meet at barrier {self.barrier}, within {show(self.timeout_s)} s"

    @override
    def attempt(self, action: StepAction) -> Coroutine:
        run, context = action.run, action.context
        if context.is_finally:  # no other task waits there
            return
        timeout_s = yield from action.number(self.timeout_s, "timeout", "timeout_s")
        key = self.meeting(context.frame)
        meeting = run.barriers.arrive(key, context.task)
        try:
            is_met = yield from run.wait_within(context, meeting, timeout_s)
        finally:
            run.barriers.withdraw(key, context.task)
        if not is_met:
            names = [name for name in run.barriers.missing(key) if name != context.task.name]
            few = ", ".join(names) if len(names) <= 3 else f"{', '.join(names[:3])} and {len(names) - 3} more"
            raise DeadlineError(f"barrier '{self.barrier}': {few} did not come within {timeout_s:g} s")


class WaitForStep(WaitingStep):
    """Wait for a signal; one that came before counts."""

    kind = "wait_for"
    wait_for: Name
    count: Count = 1
    """How often it must have been given since the beginning of the run."""
    save_as: VariableName | None = None
    """Variable for the signal's last value."""
    default: Value | None = None
    """Its value when the time is up; without a default the step fails."""

    @override
    def templates(self) -> Iterable[tuple[Keys, object]]:
        return (*super().templates(), (("count",), self.count), (("default",), self.default))

    @override
    def numbers(self) -> Iterable[tuple[Keys, object, Wanted]]:
        return (*super().numbers(), (("count",), self.count, "count"))

    @override
    def assigned(self) -> Iterable[tuple[Keys, str | None]]:
        return ((("save_as",), self.save_as),)

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
        value: Any
        if (yield from run.wait_within(context, future, timeout_s)):
            value = future.get()
        elif self.default is not None:
            names = yield from action.read(self.default)
            value = render(self.default, names)
        else:
            given = run.signals.counts.get((context.frame, self.wait_for), 0)
            often = f"; it was given {given} of {count} times" if count > 1 else ""
            raise DeadlineError(f"signal '{self.wait_for}' was not given within {timeout_s:g} s{often}")
        run.assign(context, self.save_as, value)


class WaitStep(FallibleStep):
    """Wait for a time."""

    kind = "wait_s"
    wait_s: Seconds
    """Seconds of the fleet's clock."""

    @override
    def templates(self) -> Iterable[tuple[Keys, object]]:
        return ((("wait_s",), self.wait_s),)

    @override
    def numbers(self) -> Iterable[tuple[Keys, object, Wanted]]:
        return ((("wait_s",), self.wait_s, "seconds"),)

    @override
    def check_values(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        check.unit(self.wait_s, (*path, "wait_s"), "s", "this")
        super().check_values(check, path, scope)

    @override
    def words(self, show: Show) -> str:
        return f"wait {show(self.wait_s)} s"

    @override
    def attempt(self, action: StepAction) -> Coroutine:
        duration_s = yield from action.number(self.wait_s, "seconds", "wait_s")
        action.label = f"wait_s {short_number(duration_s)}"
        yield from action.run.sleep(action.context, duration_s)


POLL_S: Final = 0.1


class WaitUntilStep(WaitingStep):
    """Wait until an expression is true."""

    kind = "wait_until"
    wait_until: ExpressionText
    """An expression, without `${}`."""
    poll_s: PositiveFloat = POLL_S
    """Time between two evaluations, in seconds of the fleet's clock."""

    @override
    def conditions(self) -> Iterable[tuple[Keys, object]]:
        return ((("wait_until",), self.wait_until),)

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
            if left_s <= 0:
                seen = describe_names(expression, names)
                raise DeadlineError(f"{self.wait_until} did not become true within {timeout_s:g} s{seen}")
            yield from run.sleep(context, min(self.poll_s, left_s))
