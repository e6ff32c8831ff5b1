"""What steps do that are neither calls nor blocks: waits, meetings, signals, variables, expectations, words."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import replace
from typing import Any

from eal_actors.device.data import EALData
from eal_actors.kernel.errors import DeadlineError, ScenarioError
from eal_actors.scenario.checks.fields import checked_number
from eal_actors.scenario.engine.cast import Context, RobotRun, Task, Unit
from eal_actors.scenario.engine.groups import Group
from eal_actors.scenario.engine.loop import Branch
from eal_actors.scenario.engine.meetings import meeting_key
from eal_actors.scenario.engine.stage import Stage
from eal_actors.scenario.events import Signalled
from eal_actors.scenario.expressions import (
    Expression,
    Known,
    bare_expressions,
    evaluate,
    evaluate_bare,
    expressions_in,
    parse_bare,
    render,
    render_text,
)
from eal_actors.scenario.expressions.evaluation import plain
from eal_actors.scenario.expressions.functions import as_text
from eal_actors.scenario.model import (
    BarrierStep,
    BlockStep,
    ExpectStep,
    LetStep,
    LogStep,
    SignalStep,
    WaitForStep,
    WaitStep,
    WaitUntilStep,
)
from eal_actors.scenario.records import told


class _SomeAct:
    """What all of them have in common."""

    resource: str | None = None
    command: str | None = None
    began_s: float | None = None
    answer: object = None
    late: Sequence[RobotRun] = ()

    def __init__(self, stage: Stage, context: Context, label: str) -> None:
        self.label = label
        self.is_begun = True
        self._stage = stage
        self._context = context


class WaitAct(_SomeAct):
    """Lets time pass."""

    def __init__(self, stage: Stage, context: Context, step: WaitStep) -> None:
        super().__init__(stage, context, f"wait_s {_short(step.wait_s)}")
        self._step = step

    def attempt(self) -> Branch:
        """See Act."""
        known = yield from self._stage.read(self._context, expressions_in(self._step.wait_s))
        duration_s = checked_number(render(self._step.wait_s, known), "seconds", "wait_s")
        self.label = f"wait_s {_short(duration_s)}"
        yield from self._stage.sleep(self._context, duration_s)


class WaitUntilAct(_SomeAct):
    """Looks at an expression until it is true."""

    def __init__(self, stage: Stage, context: Context, step: WaitUntilStep) -> None:
        super().__init__(stage, context, f"wait_until {step.wait_until}")
        self._step = step

    def attempt(self) -> Branch:
        """See Act."""
        stage, context, step = self._stage, self._context, self._step
        expression, _ = parse_bare(step.wait_until)
        timeout_s = yield from _timeout_s(stage, context, step.timeout_s)
        end_s = stage.pace.active_s() + timeout_s
        while True:
            known = yield from stage.read(context, [expression])
            if plain(evaluate(expression, known), step.wait_until):
                return
            left_s = end_s - stage.pace.active_s()
            if left_s <= 0:
                seen = _seen([expression], known)
                raise DeadlineError(f"{step.wait_until} did not become true within {timeout_s:g} s{seen}")
            yield from stage.sleep(context, min(step.poll_s, left_s))


class BarrierAct(_SomeAct):
    """Meets others."""

    def __init__(self, stage: Stage, context: Context, step: BarrierStep) -> None:
        super().__init__(stage, context, f"barrier {step.barrier}")
        self._step = step

    def attempt(self) -> Branch:
        """See Act."""
        stage, context = self._stage, self._context
        if context.is_finally:  # nobody waits there
            return
        timeout_s = yield from _timeout_s(stage, context, self._step.timeout_s)
        key = meeting_key(context.unit, self._step)
        meeting = stage.meetings.arrive(key, context.task)
        try:
            is_met = yield from stage.wait_within(context, meeting, timeout_s)
        finally:
            stage.meetings.withdraw(key, context.task)
        if not is_met:
            missing = stage.meetings.absent(key)
            names = [name for name in missing if name != context.task.name]
            raise DeadlineError(f"barrier '{self._step.barrier}': {_few(names)} did not come within {timeout_s:g} s")


class SignalAct(_SomeAct):
    """Tells those who wait."""

    def __init__(self, stage: Stage, context: Context, step: SignalStep) -> None:
        super().__init__(stage, context, f"signal {step.signal}")
        self._step = step

    def attempt(self) -> Branch:
        """See Act."""
        stage, context, step = self._stage, self._context, self._step
        value: Any = context.robot_name
        if step.value is not None:
            known = yield from stage.read(context, expressions_in(step.value))
            value = render(step.value, known)
        unit, name = context.unit, step.signal
        self._give(unit, name, value)
        while unit.outer is not None and name in unit.signals:
            unit, name = unit.outer, unit.signals[name]
            self._give(unit, name, value)

    def _give(self, unit: Unit, name: str, value: Any) -> None:
        robot, count = self._context.robot_name, self._stage.signals.give(unit, name, value)
        self._stage.tell(lambda time_s: Signalled(time_s, robot, f"{unit.prefix}{name}", count, told(value)))


class WaitForAct(_SomeAct):
    """Waits for a signal."""

    def __init__(self, stage: Stage, context: Context, step: WaitForStep) -> None:
        super().__init__(stage, context, f"wait_for {step.wait_for}")
        self._step = step

    def attempt(self) -> Branch:
        """See Act."""
        stage, context, step = self._stage, self._context, self._step
        known = yield from stage.read(context, expressions_in(step.count))
        count = int(checked_number(render(step.count, known), "count", "count"))
        timeout_s = yield from _timeout_s(stage, context, step.timeout_s)
        future = stage.signals.wait(context.unit, step.wait_for, count)
        value: Any
        if (yield from stage.wait_within(context, future, timeout_s)):
            value = future.get()
        elif step.default is not None:
            known = yield from stage.read(context, expressions_in(step.default))
            value = render(step.default, known)
        else:
            given = stage.signals.counts.get((context.unit, step.wait_for), 0)
            often = f"; it was given {given} of {count} times" if count > 1 else ""
            raise DeadlineError(f"signal '{step.wait_for}' was not given within {timeout_s:g} s{often}")
        if step.save_as is not None:
            stage.assign(context, step.save_as, value)


class LetAct(_SomeAct):
    """Gives variables a value."""

    def __init__(self, stage: Stage, context: Context, step: LetStep) -> None:
        super().__init__(stage, context, f"let {', '.join(step.let)}")
        self._step = step

    def attempt(self) -> Branch:
        """See Act."""
        for name, value in self._step.let.items():
            known = yield from self._stage.read(self._context, bare_expressions(value))
            self._stage.assign(self._context, name, evaluate_bare(value, known))


class ExpectAct(_SomeAct):
    """Holds something against what it should be."""

    def __init__(self, stage: Stage, context: Context, step: ExpectStep) -> None:
        super().__init__(stage, context, f"expect {step.expect}")
        self._step = step

    def attempt(self) -> Branch:
        """See Act."""
        step = self._step
        expression, _ = parse_bare(step.expect)
        expressions = [expression, *expressions_in((step.equals, step.says))]
        known = yield from self._stage.read(self._context, expressions)
        found = plain(evaluate(expression, known), step.expect)
        if step.equals is None:
            is_right, wanted = bool(found), "to be true"
        else:
            target = plain(render(step.equals, known), "equals")
            is_right = _equal(found, target, step.tolerance or 0.0)
            around = f" ± {step.tolerance:g}" if step.tolerance else ""
            wanted = f"to be {in_few_words(target)}{around}"
        if not is_right:
            says = f"{render_text(step.says, known)}: " if step.says is not None else ""
            seen = _seen([expression], known) if step.equals is None else f", but it is {in_few_words(found)}"
            raise ScenarioError(f"{says}expected {step.expect} {wanted}{seen}")


class LogAct(_SomeAct):
    """Tells those who watch."""

    def __init__(self, stage: Stage, context: Context, step: LogStep) -> None:
        super().__init__(stage, context, "log")
        self._step = step

    def attempt(self) -> Branch:
        """See Act."""
        known = yield from self._stage.read(self._context, expressions_in(self._step.log))
        self._stage.log(self._context.robot_name, render_text(self._step.log, known))


class WorkOutAct(_SomeAct):
    """Works out what a block needs to know.

    Attributes:
        value: what came of it; None if it failed.
    """

    def __init__(
        self,
        stage: Stage,
        context: Context,
        label: str,
        expressions: Iterable[Expression],
        work: Callable[[Known], Any],
    ) -> None:
        super().__init__(stage, context, label)
        self.value: Any = None
        self._expressions = list(expressions)
        self._work = work

    def attempt(self) -> Branch:
        """See Act."""
        known = yield from self._stage.read(self._context, self._expressions)
        self.value = self._work(known)


class TimedAct(_SomeAct):
    """Goes through a block's steps for so long at most.

    Attributes:
        late: of a block outside of any `on`, the robots that were at work in it when its time was up.
    """

    def __init__(
        self,
        stage: Stage,
        context: Context,
        step: BlockStep,
        meets: frozenset[Hashable],
        inside: Callable[[Context], Branch],
    ) -> None:
        super().__init__(stage, context, step.kind)
        self._step = step
        self._meets = meets
        self._inside = inside

    def attempt(self) -> Branch:
        """See Act."""
        stage, context = self._stage, self._context
        self.began_s = stage.now_s()
        timeout_s = yield from _timeout_s(stage, context, self._step.timeout_s or 0.0)
        task = Task(context.task, context.seat, meets=self._meets)
        group = Group(stage, context, "all", timeout_s)
        yield from group.perform([(task, self._inside(replace(context, task=task)))])
        if group.late is not None:
            self.late = group.late if context.seat is None else ()
            raise DeadlineError(f"{self.label} was not through within {timeout_s:g} s")


def _timeout_s(stage: Stage, context: Context, timeout_s: float | str) -> Any:
    known = yield from stage.read(context, expressions_in(timeout_s))
    return checked_number(render(timeout_s, known), "timeout", "timeout_s")


def _equal(found: Any, wanted: Any, tolerance: float) -> bool:
    if isinstance(found, list | tuple) and isinstance(wanted, list | tuple):
        pairs = list(zip(found, wanted, strict=False))
        return len(found) == len(wanted) and all(_equal(one, other, tolerance) for one, other in pairs)
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in (found, wanted))
    if numbers:
        return bool(math.isclose(found, wanted, rel_tol=0.0, abs_tol=tolerance + 1e-12 * tolerance))
    return bool(type(found) is type(wanted) and found == wanted)


def _seen(expressions: Iterable[Expression], known: Known) -> str:
    """Return what readings and variables of an expression were, for messages."""
    parts = []
    for expression in expressions:
        parts += [f"{reading} is {in_few_words(known.readings[reading])}" for reading, _ in expression.readings]
        parts += [
            f"{name.name} is {in_few_words(known.variables[name.name])}"
            for name in expression.names
            if name.name in known.variables and name.name != "run"
        ]
    return f", but {', '.join(parts)}" if parts else ""


def in_few_words(value: object) -> str:
    """Return a value in few words."""
    inner = value.value if isinstance(value, EALData) else value
    if isinstance(inner, float):
        return f"{inner:.6g}"
    if isinstance(inner, bool):
        return as_text(inner)
    try:
        text = repr(inner.tolist() if hasattr(inner, "tolist") and getattr(inner, "size", 99) <= 8 else inner)
    except Exception:  # noqa: BLE001  # a function's own object may raise whatever it likes
        text = f"of type {type(inner).__name__}"
    return text if len(text) <= 60 else f"{text[:57]}..."


def _short(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _few(names: list[str]) -> str:
    more = len(names) - 3
    return ", ".join(names) if more <= 0 else f"{', '.join(names[:3])} and {more} more"
