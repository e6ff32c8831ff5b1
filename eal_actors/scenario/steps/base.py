"""The interface of step kinds.

The loader, the checks, the plan and the engine see steps only through `Step`. A kind overrides what it needs: most have
fields, `templates` or `conditions`, `words`, `label` and `attempt`. Blocks also have `children`.

A step describes itself; it holds no state of a run, for many robots may perform one step at the same time.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Annotated, ClassVar, TypeAlias

from pydantic import Field, NonNegativeFloat
from typing_extensions import override

from eal_actors.kernel.errors import Problem
from eal_actors.kernel.strict_model import DeferredType, StrictModel
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.scenario.engine.action import StepAction
from eal_actors.scenario.engine.executor import perform_step, perform_within
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.engine.python_functions import StepFunction
from eal_actors.scenario.engine.synchronization import find_meetings
from eal_actors.scenario.language.expressions import LocatedExpression, Namespace, locate_expressions, render
from eal_actors.scenario.language.values import (
    MIN_ITEMS,
    NOT_EMPTY,
    OnFailure,
    Timeout,
    Wanted,
    checked_number,
    final_action,
)
from eal_actors.scenario.steps.wording import short_number, show_value

if TYPE_CHECKING:  # the scenario's model consists of steps
    from eal_actors.device.info import ResourceInfo
    from eal_actors.scenario.engine.context import RunContext
    from eal_actors.scenario.engine.frames import ExecutionContext, Frame
    from eal_actors.scenario.engine.plan import Plan
    from eal_actors.scenario.language.robot_check import RobotCheck, RobotScope
    from eal_actors.scenario.language.scenario import Scenario
    from eal_actors.scenario.language.scope import Scope, ScopeCheck
    from eal_actors.scenario.report.timeline import TimelineBuilder, TimelineEntry

Keys: TypeAlias = tuple[str | int, ...]
"""The keys from a step to one of its values."""
Show: TypeAlias = Callable[[object], str]
"""Returns a value for people, with the values of parameters inserted."""


def _any_kind() -> object:
    from eal_actors.scenario.steps.registry import step_union  # it imports the kinds, which import this module

    return step_union()


class Step(StrictModel):
    """A step of a scenario.

    Attributes:
        kind: the key that names the kind.
        is_expectation: it checks the run, so that its failure is a result.
    """

    kind: ClassVar[str]
    is_expectation: ClassVar[bool] = False

    safe_to_repeat: bool | None = None
    """For steps of the top level: a resumed run may repeat the step; defaults to that of the file."""
    lost_after_s: NonNegativeFloat | None = None
    """Time out of reach after which the step of a robot fails, in seconds of the fleet's clock; also for the steps
    inside; defaults to that of the block around it, or of the file."""

    # Structure.

    def children(self) -> Sequence[tuple[Keys, tuple[Step, ...]]]:
        """Return the lists of steps inside the step, each with its keys."""
        return ()

    @property
    def part_file(self) -> str | None:
        """The file of the scenario that the step runs, relative to its own."""
        return None

    @property
    def own_role(self) -> str | None:
        """The role whose robots perform the steps inside."""
        return None

    @property
    def saves_files(self) -> bool:
        """Whether the step itself writes into the run's folder."""
        return False

    def prepare(self, fleet: FleetConfig, functions: dict[str, StepFunction]) -> str | None:
        """Add the Python function that the step calls to those of the run; return a problem with it, or None."""
        return None

    def may_repeat(self, plan: Plan, info: ResourceInfo | None, command: str | None) -> bool:
        """Return whether performing the step again, after it was interrupted, leads to the same state as once.

        Args:
            plan: of the run.
            info: the description of the resource that it calls, if there is one.
            command: the text argument of its call.
        """
        return not self.children()

    def given_signals(self) -> Iterable[str]:
        """Return the signals that the step itself gives."""
        return ()

    def roles_at_work(self, scenario: Scenario, path: YamlPath) -> Iterator[str]:
        """Yield the roles at work in the step, by their names in this scenario."""
        for keys, steps in self.children():
            yield from scenario.roles_at_work(steps, (*path, *keys))

    def needs_everyone(self) -> bool:
        """Return whether the step may use every robot, whatever its role."""
        return any(step.needs_everyone() for _, steps in self.children() for step in steps)

    def meeting(self, frame: Frame) -> Hashable | None:
        """Return the key of the meeting that the step takes part in, or None."""
        return None

    # Expressions.

    def templates(self) -> Iterable[tuple[Keys, object]]:
        """Return the values of the step that may hold `${...}`."""
        return ()

    def conditions(self) -> Iterable[tuple[Keys, object]]:
        """Return the values of the step that are expressions without `${}`."""
        return ()

    def numbers(self) -> Iterable[tuple[Keys, object, Wanted]]:
        """Return those of the templates that must be numbers, with their ranges."""
        return ()

    def assigned(self) -> Iterable[tuple[Keys, str | None]]:
        """Return the variables that the step assigns."""
        return ()

    def expressions(self) -> Iterator[LocatedExpression]:
        """Yield the expressions of the step, without those of the steps inside it."""
        for keys, value in self.templates():
            yield from locate_expressions(keys, value)
        for keys, value in self.conditions():
            yield from locate_expressions(keys, value, is_bare=True)

    # Checks.

    def check(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        """Check the step against its surroundings, and then the steps inside it."""
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

    def check_robots(self, check: RobotCheck, path: YamlPath, here: RobotScope) -> None:
        """Check the step, and the steps inside it, on the robots that come to it."""
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

    def shared_robots(
        self, scenario: Scenario, path: YamlPath, roles: Mapping[str, Sequence[str]]
    ) -> Iterator[Problem]:
        """Yield a problem for each robot that two branches of a block would use at the same time."""
        for keys, steps in self.children():
            for index, step in enumerate(steps):
                yield from step.shared_robots(scenario, (*path, *keys, index), roles)

    # Wording.

    def describe(self, parameters: Mapping[str, object]) -> str:
        """Return what the step does, for people, with the values of parameters; without the steps inside it."""
        return self.words(partial(show_value, parameters=parameters))

    def words(self, show: Show) -> str:
        """Return the same, with `show` for all values."""
        return self.kind

    def branch_words(self, keys: Keys) -> tuple[str, str] | None:
        """Return the kind and the text of the timeline entry for a list of steps inside; None if it needs no entry."""
        return None

    def timeline(
        self, builder: TimelineBuilder, path: YamlPath, robots: tuple[str, ...]
    ) -> tuple[tuple[str, ...], tuple[TimelineEntry, ...]]:
        """Return the robots of the step's timeline entry, and the entries inside it."""
        return robots, builder.children(self, path, robots)

    # Planning.

    def passes(self, scenario: Scenario) -> int | None:
        """Return how often the steps inside run; None if that is known only during the run."""
        return 1

    def own_calls(self, robots: int) -> int:
        """Return the number of calls that the step itself makes with so many robots."""
        return 0

    def count_calls(self, scenario: Scenario, path: YamlPath, robots: int | None, live: Mapping[str, int]) -> int:
        """Return the number of calls if nothing fails, as far as it is known.

        Args:
            scenario: the scenario of the step.
            path: of the step.
            robots: the number of robots of the `on` around the step; None outside of `on`.
            live: the number of robots of each role.
        """
        count = self.own_calls(robots or 0)
        passes = self.passes(scenario)
        for keys, steps in self.children() if passes else ():
            count += (passes or 0) * scenario.count_calls(steps, (*path, *keys), robots, live)
        return count

    # Execution.

    def perform(self, run: RunContext, context: ExecutionContext, path: str) -> Coroutine:
        """Perform the step for the robot of a context, or for none outside of `on`.

        Thread: the run's own.
        """
        raise NotImplementedError


AnyStep: TypeAlias = Annotated[Step, DeferredType(_any_kind)]
"""A step in a file. Its type is the union of all kinds, which is built when the first file is read."""
Steps: TypeAlias = Annotated[tuple[AnyStep, ...], Field(strict=False, json_schema_extra=MIN_ITEMS), NOT_EMPTY]


class FallibleStep(Step):
    """A step that can fail.

    Attributes:
        is_instant: it takes no time, so that only its failure is recorded.
        meets_again: a resumed run performs it again although it was over.
    """

    is_instant: ClassVar[bool] = False
    meets_again: ClassVar[bool] = False

    on_failure: OnFailure | None = None
    """The policy if it fails; defaults to that of the block around it, of the role or of the file."""

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
        """Perform the step once.

        Raises:
            EALError: the attempt failed.
        """
        raise NotImplementedError

    @override
    def perform(self, run: RunContext, context: ExecutionContext, path: str) -> Coroutine:
        make = partial(StepAction, run, context, self.label, self.attempt)
        yield from perform_step(run, context, self, path, make, is_quiet=self.is_instant)


class LimitedStep(FallibleStep):
    """A step with a time limit."""

    timeout_s: Timeout | None = None

    @override
    def templates(self) -> Iterable[tuple[Keys, object]]:
        return ((("timeout_s",), self.timeout_s), *super().templates())

    @override
    def numbers(self) -> Iterable[tuple[Keys, object, Wanted]]:
        return ((("timeout_s",), self.timeout_s, "timeout"), *super().numbers())

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

        Raises:
            ScenarioError: it is an expression, and its value is not a number over 0.
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
        return perform_within(run, context, self, path, meets, partial(self.perform_inside, run, path=path))

    def perform_inside(self, run: RunContext, context: ExecutionContext, path: str) -> Coroutine:
        """Perform the steps inside; the time limit is already handled."""
        raise NotImplementedError
