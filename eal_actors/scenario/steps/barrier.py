"""The step `barrier`: meet the other robots or branches that have a barrier of the same name."""

from __future__ import annotations

from collections.abc import Hashable

from typing_extensions import override

from eal_actors.kernel.errors import DeadlineError
from eal_actors.kernel.strict_model import Name
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.engine.action import StepAction
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.scenario import Show
from eal_actors.scenario.language.scope import Scope, ScopeCheck
from eal_actors.scenario.steps.base import WaitingStep


class BarrierStep(WaitingStep, kind="barrier"):
    """Wait for all robots and branches that have a barrier of this name."""

    meets_again = True
    barrier: Name

    @override
    def meeting(self, frame: Hashable) -> Hashable:
        return frame, self.barrier

    @override
    def check_placement(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        super().check_placement(check, path, scope)
        if not scope.is_beside:
            check.report((*path, "barrier"), "a barrier must be inside an 'on' or a 'parallel'", key=True)

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
            missing = run.barriers.missing(key, context.task)
            raise DeadlineError(f"barrier '{self.barrier}': {missing} did not come within {timeout_s:g} s")
