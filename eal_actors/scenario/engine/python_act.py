"""Runs a Python function as a step, in a thread of its own and with a deadline."""

from __future__ import annotations

import contextvars
import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final

from eal_actors.actors.future import Future
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import EALError, ScenarioError, error_text
from eal_actors.kernel.log import get_logger
from eal_actors.scenario.engine.calls import timeout_of
from eal_actors.scenario.engine.cast import Context, RobotRun
from eal_actors.scenario.engine.loop import Branch, Loop
from eal_actors.scenario.engine.stage import Stage
from eal_actors.scenario.expressions import expressions_in, render
from eal_actors.scenario.model import PythonStep
from eal_actors.scenario.python_steps import StepContext

DEFAULT_TIMEOUT_S: Final = 60.0
"""Deadline where neither the step nor the scenario gives one, in real seconds."""


class _Answer(Future[Any]):
    """What a function will return."""

    def __init__(self, name: str, clock: Clock, deadline_s: float, loop: Loop) -> None:
        super().__init__(clock, deadline_s, loop)
        self._name = name

    def describe(self) -> str:
        return f"Python step '{self._name}'"


class PythonAct:
    """Runs a function."""

    resource: str | None = None
    command: str | None = None
    began_s: float | None = None
    answer: object = None
    late: Sequence[RobotRun] = ()

    def __init__(self, stage: Stage, context: Context, step: PythonStep) -> None:
        self.label = f"python {step.python}"
        self.is_begun = False
        self._stage = stage
        self._context = context
        self._step = step

    def attempt(self) -> Branch:
        """See Act."""
        stage, context, step = self._stage, self._context, self._step
        known = yield from stage.read(context, expressions_in((*step.with_.values(), step.timeout_s)))
        given = {name: render(value, known) for name, value in step.with_.items()}
        limit_s = timeout_of(step, context, known) or stage.clock.of_real(DEFAULT_TIMEOUT_S)
        answer = _Answer(step.python, stage.clock, stage.clock.now() + limit_s, stage.loop)
        function = stage.plan.python.functions[step.python]
        step_context = self._context_of(answer, dict(known.variables))
        self.is_begun = True
        context.task.touch(None)
        work = partial(contextvars.copy_context().run, _work, function, step_context, given, answer)
        thread = threading.Thread(target=work, name=f"python step {step.python}", daemon=True)
        stage.threads.append(thread)
        stage.clock.start(thread)
        yield from stage.wait(context, answer)
        value = answer.get()
        if step.save_as is not None:
            stage.assign(context, step.save_as, value)

    def _context_of(self, answer: Future[Any], variables: dict[str, Any]) -> StepContext:
        stage, robot = self._stage, self._context.robot_name

        def log(text: str) -> None:
            line = str(text)
            stage.loop.post(lambda: stage.log(robot, line))

        return StepContext(
            robots=stage.handles(self._context),
            robot=robot,
            directory=stage.folder,
            clock=stage.clock,
            variables=variables,
            seed=stage.seed,
            is_cancelled=answer.done,
            log=log,
        )


def _work(function: Callable[..., Any], context: StepContext, given: dict[str, Any], answer: Future[Any]) -> None:
    try:
        answer.set(function(context, **given))
    except EALError as error:
        answer.set_exception(error)
    except BaseException as error:  # noqa: BLE001  # it is the user's, and somebody waits for it
        get_logger(step=threading.current_thread().name).debug("the function raised", exc_info=error)
        answer.set_exception(ScenarioError(f"{answer.describe()} raised {error_text(error)}"))
