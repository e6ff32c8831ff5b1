"""Calls of resources, one by one or begun by all robots of an `on` at the same time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eal_actors.actors.call import Call
from eal_actors.actors.future import Future
from eal_actors.kernel.errors import EALError, ScenarioError
from eal_actors.scenario.checks.fields import checked_number
from eal_actors.scenario.engine.cast import Context, RobotRun
from eal_actors.scenario.engine.loop import Branch
from eal_actors.scenario.engine.stage import Stage
from eal_actors.scenario.engine.together import Start, join_start
from eal_actors.scenario.expressions import Known, expressions_in, render, render_text
from eal_actors.scenario.files import save_answer
from eal_actors.scenario.model import TEXT_FIELDS, AnswerStep, CallStep, TimedStep, call_fields, resolved_fields


class CallAct:
    """A call of a robot's resource."""

    late: Sequence[RobotRun] = ()

    def __init__(self, stage: Stage, context: Context, step: CallStep, path: str) -> None:
        self.is_begun = False
        self.began_s: float | None = None
        self.answer: object = None
        self._stage = stage
        self._context = context
        self._step = step
        self._path = path
        self._is_first = True
        self._fields = call_fields(step)
        self.resource: str | None = step.arguments.resource
        self._expressions = list(expressions_in((self.resource, *self._fields.values(), step.timeout_s)))
        if isinstance(step, AnswerStep):
            self._expressions += expressions_in(step.save)
        try:
            self._describe(stage.known(context))
        except EALError:  # it needs what is not known yet, or will fail for it
            self._show(step.arguments.resource, self._fields)

    def _describe(self, known: Known) -> None:
        resource = render_text(self._step.arguments.resource, known) if self._expressions else self.resource
        self._fields = resolved_fields(self._step, known) if self._expressions else self._fields
        self._show(resource or "", self._fields)

    def _show(self, resource: str, fields: Mapping[str, Any]) -> None:
        self.resource = resource
        self.command: str | None = next((fields[name] for name in TEXT_FIELDS if name in fields), None)
        shown = [self._step.kind, resource, *(str(value) for value in fields.values() if value is not None)]
        self.label = " ".join(shown)

    def attempt(self) -> Branch:
        """See Act."""
        stage, context, step = self._stage, self._context, self._step
        known = yield from stage.read(context, self._expressions)
        if self._expressions:
            self._describe(known)
        timeout_s = timeout_of(step, context, known)
        robot = context.acting
        method = getattr(robot.handle[self.resource or ""], step.kind)
        start: Start | None = None
        if step.is_together and self._is_first:
            self._is_first = False
            start = yield from join_start(stage, context, step, self._path)
        self.is_begun = True
        context.task.touch(self.resource)
        if start is None:
            future: Future[Any] = method(**self._fields, timeout_s=timeout_s)
        else:
            future = start.begin(method, self._fields, timeout_s)
        try:
            yield from stage.wait(context, future)
        finally:
            if start is not None:
                self.began_s = start.end(robot, future if isinstance(future, Call) else None)
        self.answer = future.get()
        if isinstance(step, AnswerStep):
            self._keep(step, robot, self.answer, known)

    def _keep(self, step: AnswerStep, robot: RobotRun, answer: object, known: Known) -> None:
        stage, context = self._stage, self._context
        if step.save_as is not None:
            stage.assign(context, step.save_as, answer)
        if step.save is not None and stage.folder is not None:
            folder: Path = stage.folder / robot.name
            name = render_text(step.save, known if self._expressions else stage.known(context))
            time_s = stage.now_s()
            try:
                note = save_answer(answer, folder, name, time_s)
            except OSError as error:
                raise ScenarioError(f"could not save {name!r}: {error}") from error
            if note is not None:
                stage.log(robot.name, note)


def timeout_of(step: TimedStep, context: Context, known: Known) -> float | None:
    """Return the deadline of each attempt at a step, or None for the fleet's own.

    Raises:
        ScenarioError: it is worked out, and not a number over 0.
    """
    if step.timeout_s is None:
        return context.unit.timeout_s
    return checked_number(render(step.timeout_s, known), "timeout", "timeout_s")
