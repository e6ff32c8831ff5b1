"""Goes through the steps of a scenario: sequences, loops, branches, roles and parts; leaves are acts."""

from __future__ import annotations

from collections.abc import Callable, Generator, Hashable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final

from eal_actors.actors.future import Future
from eal_actors.kernel.errors import ScenarioError
from eal_actors.kernel.yaml_tree import format_path
from eal_actors.scenario.checks.fields import checked_number
from eal_actors.scenario.checks.placing import roles_of
from eal_actors.scenario.engine.acts import (
    BarrierAct,
    ExpectAct,
    LetAct,
    LogAct,
    SignalAct,
    TimedAct,
    WaitAct,
    WaitForAct,
    WaitUntilAct,
    WorkOutAct,
    in_few_words,
)
from eal_actors.scenario.engine.calls import CallAct
from eal_actors.scenario.engine.cast import Context, Seat, Task, Unit
from eal_actors.scenario.engine.groups import Group
from eal_actors.scenario.engine.leaf import Act, perform_leaf
from eal_actors.scenario.engine.loop import Branch
from eal_actors.scenario.engine.meetings import meets_in
from eal_actors.scenario.engine.python_act import PythonAct
from eal_actors.scenario.engine.stage import Stage
from eal_actors.scenario.expressions import Known, evaluate, expressions_in, parse_bare, render
from eal_actors.scenario.expressions.evaluation import plain
from eal_actors.scenario.model import (
    INDEX,
    AnyStep,
    BarrierStep,
    BlockStep,
    CallStep,
    ExpectStep,
    FallibleStep,
    ForStep,
    IfStep,
    LetStep,
    LogStep,
    OnStep,
    ParallelStep,
    PythonStep,
    RepeatStep,
    ScenarioStep,
    SequenceStep,
    SignalStep,
    WaitForStep,
    WaitStep,
    WaitUntilStep,
    WhileStep,
    inner_steps,
)
from eal_actors.scenario.parameters import parameter_problem
from eal_actors.scenario.scenario import Scenario

_ACTS: Final[dict[type[AnyStep], Callable[[Stage, Context, Any], Act]]] = {
    WaitStep: WaitAct,
    WaitUntilStep: WaitUntilAct,
    BarrierStep: BarrierAct,
    SignalStep: SignalAct,
    WaitForStep: WaitForAct,
    LetStep: LetAct,
    ExpectStep: ExpectAct,
    LogStep: LogAct,
    PythonStep: PythonAct,
}
_INSTANT: Final = (LetStep, LogStep, SignalStep)
"""Steps that take no time: only their failures are recorded."""
_PASSES_AT_ONCE: Final = 200
"""After so many passes of loops, others have their turn, even if no pass waited for anything."""


class Performer:
    """Performs the steps of one run. Everything happens in the loop's thread.

    Args:
        stage: what the steps share.
    """

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self._passes = 0
        self._at = 0

    def steps(self, first: int, on_step: Callable[[int], None]) -> Branch:
        """Perform the steps of the top level.

        Args:
            first: number of the first one, from 0.
            on_step: called with the number of each that has ended as it should.
        """
        stage = self._stage
        steps = stage.plan.scenario.file.steps
        task = Task(meets=meets_in(stage.main, steps))
        context = Context(task, stage.main)
        stage.meetings.enter(task)
        self._at = first
        for index in range(first, len(steps)):
            if not stage.goes_on(context):
                return
            self._at = index
            yield from self._perform(steps[index], f"steps[{index}]", context)
            if not stage.is_stopping:
                self._at = index + 1
                on_step(index)

    def unfinished_roles(self) -> set[str]:
        """Return the roles that have something to do in a step of the top level that has not ended."""
        scenario = self._stage.plan.scenario
        if _asks_everyone(scenario.file.steps[self._at :]):
            return set(scenario.file.roles)
        return set(roles_of(scenario.file.steps, ("steps",), scenario, first=self._at))

    def finally_steps(self) -> Branch:
        """Perform the steps of `finally`, with every robot that ever took part; failures stop nothing.

        Those of scenarios that were under way as parts come first, from the innermost.
        """
        stage = self._stage
        stage.is_stopping = False
        for context in [*reversed(stage.open_units), Context(Task(), stage.main)]:
            unit = context.unit
            ending = Context(Task(seat=unit.seat), unit, unit.seat, context.role, is_finally=True)
            yield from self._sequence(unit.scenario.file.finally_, f"{unit.prefix}finally", ending)

    # Blocks.

    def _sequence(self, steps: Sequence[AnyStep], path: str, context: Context) -> Branch:
        for index, step in enumerate(steps):
            if not self._stage.goes_on(context):
                return
            yield from self._perform(step, f"{path}[{index}]", context)

    def _perform(self, step: AnyStep, path: str, context: Context) -> Branch:
        if isinstance(step, CallStep):
            make: Callable[[], Act] = partial(CallAct, self._stage, context, step, path)
            yield from perform_leaf(self._stage, context, step, path, make)
        elif type(step) in _ACTS:
            act = partial(_ACTS[type(step)], self._stage, context, step)
            is_quiet = isinstance(step, _INSTANT)
            yield from perform_leaf(self._stage, context, step, path, act, is_quiet=is_quiet)
        elif isinstance(step, OnStep):  # whose time-out is each robot's own
            yield from self._on(step, path, context)
        elif isinstance(step, ScenarioStep):  # of which `finally` belongs to no time-out
            yield from self._part(step, path, context)
        elif isinstance(step, BlockStep):
            meets = meets_in(context.unit, (step,))
            yield from self._within_time(step, path, context, meets, partial(self._block, step, path))

    def _within_time(
        self,
        step: BlockStep,
        path: str,
        context: Context,
        meets: frozenset[Hashable],
        inside: Callable[[Context], Branch],
    ) -> Branch:
        """Go through a block's steps; where it has a time-out, as a step that can fail."""
        if step.timeout_s is None:
            yield from inside(context)
            return
        make = partial(TimedAct, self._stage, context, step, meets, inside)
        yield from perform_leaf(self._stage, context, step, path, make, is_quiet=True)

    def _block(self, step: BlockStep, path: str, context: Context) -> Branch:
        match step:
            case SequenceStep():
                yield from self._sequence(step.sequence, f"{path}.sequence", context.inside(step.on_failure))
            case ParallelStep():
                yield from self._parallel(step, path, context)
            case IfStep():
                yield from self._if(step, path, context)
            case ForStep() | RepeatStep():
                yield from self._counted(step, path, context)
            case WhileStep():
                yield from self._while(step, path, context)

    def _on(self, step: OnStep, path: str, context: Context) -> Branch:
        """Let every robot of the role go through the steps, and wait for the last."""
        unit, inside = context.unit, context.inside(step.on_failure)
        meets = meets_in(unit, step.do)
        lines = []
        work = partial(self._sequence, step.do, f"{path}.do")
        for seat in self._seats(step.on, context):
            task = Task(context.task, seat, meets=meets)
            here = replace(inside, task=task, seat=seat, role=step.on)
            lines.append((task, self._within_time(step, path, here, meets, work)))
        yield from Group(self._stage, context, step.until).perform(lines)

    def _seats(self, role: str, context: Context) -> list[Seat]:
        """Return the places whose robots go through an `on`: in `finally` those of everyone who ever took part."""
        unit = context.unit
        seats = [unit.seat] if unit.seat is not None else self._stage.seats[unit.roles[role]]
        if not context.is_finally:
            return [seat for seat in seats if seat.robot.outcome is None]
        return [
            replace(seat, robot=robot) if robot is not seat.robot else seat
            for seat in seats
            for robot in (*seat.past, seat.robot)
        ]

    def _parallel(self, step: ParallelStep, path: str, context: Context) -> Branch:
        inside = context.inside(step.on_failure)
        lines = []
        for keys, steps in inner_steps(step):
            task = Task(context.task, context.seat, str(keys[-1]), meets_in(context.unit, steps))
            branch = f"{path}.{format_path(keys)}"
            lines.append((task, self._sequence(steps, branch, replace(inside, task=task))))
        yield from Group(self._stage, context, step.until).perform(lines)

    def _if(self, step: IfStep, path: str, context: Context) -> Branch:
        condition, _ = parse_bare(step.if_)
        is_true = yield from self._work_out(
            step, f"{path}.if", context, f"if {step.if_}", [condition], lambda known: bool(_plain(condition, known))
        )
        if is_true is None:
            return
        steps = step.then if is_true else step.else_
        keys = "then" if is_true else "else"
        yield from self._sequence(steps or (), f"{path}.{keys}", context.inside(step.on_failure))

    def _counted(self, step: ForStep | RepeatStep, path: str, context: Context) -> Branch:
        name = step.variable if isinstance(step, ForStep) else INDEX
        values: Any
        if isinstance(step, ForStep):
            values = step.values
            if any(expressions_in(values)):
                values = yield from self._work_out(
                    step, f"{path}.for.{name}", context, f"for {name}", expressions_in(values), partial(_list, values)
                )
        else:
            count: Any = step.repeat
            if isinstance(count, str):
                count = yield from self._number(step, f"{path}.repeat", context, count, "repeat")
            values = range(count or 0)
        inside = context.inside(step.on_failure)
        for value in values or ():
            if not self._stage.goes_on(context):
                return
            yield from self._breathe()
            yield from self._sequence(step.do, f"{path}.do", inside.in_loop(name, value))

    def _while(self, step: WhileStep, path: str, context: Context) -> Branch:
        limit: Any = step.limit
        if isinstance(limit, str):
            limit = yield from self._number(step, f"{path}.limit", context, limit, "limit")
        condition, _ = parse_bare(step.while_)
        label = f"while {step.while_}"
        inside = context.inside(step.on_failure)
        for number in range(limit + 1 if limit is not None else 0):
            here = inside.in_loop(INDEX, number)
            if not self._stage.goes_on(here):
                return
            yield from self._breathe()
            is_last = number == limit and step.at_limit == "fail"
            work = partial(_go_on, condition, limit if is_last else None)
            goes_on = yield from self._work_out(step, f"{path}.while", here, label, [condition], work)
            if not goes_on or number == limit:
                return
            yield from self._sequence(step.do, f"{path}.do", here)

    def _breathe(self) -> Branch:
        self._passes += 1
        if self._passes % _PASSES_AT_ONCE == 0:
            yield self._stage.loop.breathe()

    def _number(
        self, step: FallibleStep, path: str, context: Context, text: str, what: str
    ) -> Generator[Future[Any], None, Any]:
        def work(known: Known) -> Any:
            return int(checked_number(render(text, known), "count", what))

        return (yield from self._work_out(step, path, context, f"{what} {text}", expressions_in(text), work))

    def _work_out(
        self,
        step: FallibleStep,
        path: str,
        context: Context,
        label: str,
        expressions: Any,
        work: Callable[[Known], Any],
    ) -> Generator[Future[Any], None, Any]:
        """Return what a block needs to know, or None if that failed, and was dealt with as the policy says."""
        acts: list[WorkOutAct] = []
        needed = list(expressions)

        def make() -> WorkOutAct:
            acts.append(WorkOutAct(self._stage, context, label, needed, work))
            return acts[-1]

        yield from perform_leaf(self._stage, context, step, path, make, is_quiet=True)
        return acts[-1].value if acts else None

    # Parts.

    def _part(self, step: ScenarioStep, path: str, context: Context) -> Branch:
        """Carry out another scenario, and its end."""
        stage, outer, seat = self._stage, context.unit, context.seat
        scenario = outer.scenario.parts[path.removeprefix(outer.prefix)]
        parameters = yield from self._part_parameters(step, scenario, path, context)
        if parameters is None:
            return
        roles = {theirs: outer.roles[step.roles.get(theirs, theirs)] for theirs in scenario.file.roles if seat is None}
        unit = Unit(scenario, roles, parameters, f"{path}.{scenario.name}.", outer, step.signals, seat)
        meets = meets_in(unit, scenario.file.steps)
        task = Task(context.task, seat, meets=meets)
        here = Context(task, unit, seat, context.role, is_finally=context.is_finally)
        stage.open_units.append(here)

        def steps(around: Context) -> Branch:
            inside = replace(here, task=around.task)
            yield from self._sequence(scenario.file.steps, f"{unit.prefix}steps", inside)

        line = self._within_time(step, path, replace(context, task=task), meets, steps)
        yield from Group(stage, context, "all").perform([(task, line)])
        if stage.goes_on(context):
            stage.open_units.remove(here)
            ending = replace(here, task=Task(context.task, seat), is_finally=True)
            yield from self._sequence(scenario.file.finally_, f"{unit.prefix}finally", ending)

    def _part_parameters(
        self, step: ScenarioStep, scenario: Scenario, path: str, context: Context
    ) -> Generator[Future[Any], None, dict[str, object] | None]:
        """Return the values of another scenario's parameters, or None if they could not be worked out."""
        needs = list(expressions_in(tuple(step.with_.values())))
        parameters = dict(scenario.parameters)

        def work(known: Known) -> dict[str, object]:
            for name, value in step.with_.items():
                found = plain(render(value, known), name)
                if (problem := parameter_problem(scenario.file.parameters[name], found)) is not None:
                    raise ScenarioError(f"parameter '{name}' of scenario '{scenario.name}' {problem}")
                parameters[name] = found
            return parameters

        label = f"scenario {step.scenario}"
        found: dict[str, object] | None = yield from self._work_out(step, path, context, label, needs, work)
        return found


def _asks_everyone(steps: Sequence[AnyStep]) -> bool:
    """Return whether Python steps outside of any `on` are among them, which may use every robot."""
    return any(
        isinstance(step, PythonStep)
        or (not isinstance(step, OnStep) and any(_asks_everyone(inner) for _, inner in inner_steps(step)))
        for step in steps
    )


def _plain(condition: Any, known: Known) -> Any:
    return plain(evaluate(condition, known), "the condition")


def _go_on(condition: Any, limit: int | None, known: Known) -> bool:
    """Return whether a condition is true; where that must not be any more, raise ScenarioError."""
    is_true = bool(_plain(condition, known))
    if is_true and limit is not None:
        raise ScenarioError(f"{condition.text.strip()} is still true after {limit} rounds, the limit")
    return is_true


def _list(values: object, known: Known) -> list[Any]:
    found = plain(render(values, known), "the list")
    if not isinstance(found, list):
        raise ScenarioError(f"a loop goes through a list, and this is none: {in_few_words(found)}")
    return found
