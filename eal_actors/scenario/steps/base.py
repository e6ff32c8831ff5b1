"""The interface of step kinds.

`Step`, in the scenario's model, has the structure, the expressions, the wording and the planning of a step; the loader,
the checks, the plan and the engine see steps only through it. `StepKind` adds its checks on the file and on robots, its
timeline entry and its execution. A kind overrides what it needs: most have fields, `templates` or `conditions`,
`words`, `label` and `attempt`. Blocks also have `children`.

A step describes itself; it holds no state of a run, for many robots may perform one step at the same time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import ClassVar

from typing_extensions import override

from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.engine.action import StepAction
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.executor import perform_step, perform_within
from eal_actors.scenario.engine.frames import ExecutionContext
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.engine.synchronization import find_meetings
from eal_actors.scenario.language.expressions.evaluation import Namespace, render
from eal_actors.scenario.language.robot_check import RobotCheck, RobotScope
from eal_actors.scenario.language.scenario import FallibleModel, Keys, Show, Step
from eal_actors.scenario.language.scope import Scope, ScopeCheck
from eal_actors.scenario.language.values import Held, Timeout, checked_number, final_action
from eal_actors.scenario.language.wording import short_number
from eal_actors.scenario.report.timeline import StepTimeline, TimelineBuilder


class StepKind(Step):
    """The visits of a kind: its checks, its timeline entry and its execution, for the kind to override."""

    # Checks.

    @override
    def check(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        if self.safe_to_repeat is not None and not (scope.is_top and path[0] == "steps"):
            check.report((*path, "safe_to_repeat"), "is allowed only for steps of the top level", key=True)
        if self.lost_after_s is not None and scope.role is None and not self.children() and self.part_file is None:
            check.report((*path, "lost_after_s"), "has no effect: the step is outside of 'on'", key=True)
        self.check_placement(check, path, scope)
        self.check_values(check, path, scope)
        inside = self.scope_inside(check, scope)
        for keys, steps in self.children():
            check.visit_all(steps, (*path, *keys), inside)

    def check_placement(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        """Check whether the step is allowed where it is, and its references to roles, signals and files."""

    def check_values(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        """Check the expressions of the step, and the variables that it assigns."""
        for keys, value in self.templates():
            check.template(value, (*path, *keys), scope)
        for keys, value in self.conditions():
            check.expression(value, (*path, *keys), scope)
        for keys, name in self.assigned():
            check.assign(name, (*path, *keys), scope)

    def scope_inside(self, check: ScopeCheck, scope: Scope) -> Scope:
        """Return the scope of the steps inside the step."""
        return scope.inside()

    @override
    def check_robots(self, check: RobotCheck, path: YamlPath, here: RobotScope) -> None:
        self.check_numbers(check, path, here)
        for located in self.expressions():
            check.expression(located, path, here)
        for keys, steps in self.children():
            check.visit_all(steps, (*path, *keys), self.robots_inside(check, path, here, keys))

    def check_numbers(self, check: RobotCheck, path: YamlPath, here: RobotScope) -> None:
        """Check the numbers that are expressions, and the readings of all expressions."""
        for keys, value, wanted in self.numbers():
            if isinstance(value, str):
                check.number(value, wanted, (*path, *keys), here)
        for located in self.expressions():
            check.readings(located, path, here)

    def robots_inside(self, check: RobotCheck, path: YamlPath, here: RobotScope, keys: Keys) -> RobotScope:
        """Return the scope, on the robots, of the steps at some keys inside the step."""
        return here

    @override
    def timeline(self, builder: TimelineBuilder, path: YamlPath, robots: tuple[str, ...]) -> StepTimeline:
        return robots, builder.children(self, path, robots)


class FallibleStep(FallibleModel, StepKind):
    """A step that can fail."""

    def check_placement(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        """Check the failure policy."""
        if self.on_failure is None:
            return
        here = (*path, "on_failure")
        if scope.is_finally:
            message = "has no effect in 'finally': a failure there is recorded, and the next step runs"
            check.report(here, message, key=True)
            return
        action = final_action(self.on_failure)
        role = scope.role or self.own_role
        if action not in ("drop", "substitute"):
            return
        if role is not None:
            check.spares(self.on_failure, here, [role])
        elif not self.children() and self.part_file is None:
            check.report(here, f"there is no robot to {action}: the step is outside of 'on'", key=True)

    @property
    def label(self) -> str:
        """The step in records, for people: its kind, and the value under the key of the kind."""
        return f"{self.kind} {short_number(getattr(self, self.kind))}"

    def attempt(self, action: StepAction) -> Coroutine:
        """Perform the step once; raise EALError if the attempt failed."""
        raise NotImplementedError

    @override
    def perform(self, run: RunContext, context: ExecutionContext, path: str) -> Coroutine:
        make = partial(StepAction, run, context, self.label, self.attempt)
        yield from perform_step(run, context, self, path, make, is_quiet=self.is_instant)


class LimitedStep(FallibleStep):
    """A step with a time limit."""

    holds: ClassVar[Mapping[str, Held]] = {"timeout_s": "timeout"}
    timeout_s: Timeout | None = None

    @override
    def check_values(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        check.unit(self.timeout_s, (*path, "timeout_s"), "s", "this")
        super().check_values(check, path, scope)


class TimedStep(LimitedStep):
    """A step whose attempts have a deadline."""

    timeout_s: Timeout | None = None
    """Deadline of each attempt, in seconds of the fleet's clock; defaults to that of the file."""

    def deadline_s(self, context: ExecutionContext, names: Namespace) -> float | None:
        """Return the deadline of each attempt, or None for the fleet's own.

        Raises ScenarioError if it is an expression, and its value is not a number over 0.
        """
        if self.timeout_s is None:
            return context.frame.timeout_s
        return checked_number(render(self.timeout_s, names), "timeout", "timeout_s")


class WaitingStep(LimitedStep):
    """A step that waits for something that may never happen."""

    timeout_s: Timeout
    """Maximum time to wait, in seconds of the fleet's clock."""


class BlockStep(LimitedStep):
    """A step that holds steps."""

    timeout_s: Timeout | None = None
    """Maximum time of the whole block, in seconds of the fleet's clock; inside an `on`, and for the `do` of an `on`, of
    each robot. Then the steps under way are stopped, and the block fails."""

    @override
    def children(self) -> Sequence[tuple[Keys, tuple[Step, ...]]]:
        do: tuple[Step, ...] = getattr(self, "do", ())
        return ((("do",), do),)

    @override
    def words(self, show: Show) -> str:
        limit = f", within {show(self.timeout_s)} s" if self.timeout_s is not None else ""
        return self.block_words(show) + limit

    def block_words(self, show: Show) -> str:
        """Return what the block does, for people, without its time limit."""
        return self.kind

    @override
    def perform(self, run: RunContext, context: ExecutionContext, path: str) -> Coroutine:
        meets = find_meetings(context.frame, (self,))
        return perform_within(
            run, context, self, self.timeout_s, path, meets, partial(self.perform_inside, run, path=path)
        )

    def perform_inside(self, run: RunContext, context: ExecutionContext, path: str) -> Coroutine:
        """Perform the steps inside; the time limit is already handled."""
        raise NotImplementedError
