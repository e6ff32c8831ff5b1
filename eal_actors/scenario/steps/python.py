"""The step `python`: run a Python function in a thread of its own."""

from __future__ import annotations

import contextvars
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Final

from pydantic import Field
from typing_extensions import override

from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.device.info import ResourceInfo
from eal_actors.kernel.clock import CancelScope, Clock, in_scope
from eal_actors.kernel.errors import EALError, ScenarioError, error_text
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.strict_model import NAMES_ONLY
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.scenario.engine.action import StepAction
from eal_actors.scenario.engine.loop import Coroutine, EventLoop
from eal_actors.scenario.engine.python_functions import StepFunction, find_function
from eal_actors.scenario.language.expressions.evaluation import render
from eal_actors.scenario.language.scenario import Keys, Show
from eal_actors.scenario.language.values import Held, Text, Value, VariableName
from eal_actors.scenario.report.records import as_json, to_record
from eal_actors.scenario.steps.base import TimedStep

DEFAULT_TIMEOUT_S: Final = 60.0
"""The deadline if neither the step nor the scenario has one, in real seconds."""


@dataclass(frozen=True, slots=True)
class StepContext:
    """The first argument of the function of a Python step.

    Attributes:
        robots: the robots it may use, by name: the one of the `on` around it, or all that take part outside of one.
        robot: the robot of the `on` around it, or None.
        directory: the run's folder, for files of the step; None if nothing is kept. Files of a robot go into its
            folder there, `directory / robot`.
        variables: the current variables of the scenario, by name; changes have no effect.
        seed: the fleet's seed, the source of all randomness.
        is_cancelled: returns whether the result is no longer needed: the deadline has passed, or the run was stopped.
            From then on `get`, streams and `clock.sleep` raise CallCancelledError. A function that computes or waits
            otherwise for long must call it regularly, and return.
        log: sends a line of text to those who watch the run. Thread: the step's own; does not block.
        keeps_files: false in a run whose files are thrown away, such as those of a proof: a function may leave out
            work whose only result is a file.
    """

    robots: Mapping[str, RobotHandle]
    robot: str | None
    directory: Path | None
    clock: Clock
    variables: Mapping[str, Any]
    seed: int
    is_cancelled: Callable[[], bool]
    log: Callable[[str], None]
    keeps_files: bool = True


class PythonStep(TimedStep, kind="python"):
    """Run a function of Python in a thread of its own."""

    holds: ClassVar[Mapping[str, Held]] = {"save_as": "variable"}
    python: Text
    """An entry point of the group `eal_actors.steps`, or `module:function` if the fleet file allows it."""
    with_: dict[VariableName, Value] = Field(default={}, alias="with", json_schema_extra=NAMES_ONLY)
    """The function's arguments by name."""
    save_as: VariableName | None = None
    """Variable for its result."""

    @override
    def prepare(self, fleet: FleetConfig, functions: dict[str, StepFunction]) -> str | None:
        return find_function(self.python, self.with_, fleet, functions)

    @override
    def may_repeat(self, functions: Mapping[str, StepFunction], info: ResourceInfo | None, command: str | None) -> bool:
        return bool(getattr(functions[self.python], "safe_to_repeat", False))

    @override
    def needs_everyone(self) -> bool:
        return True

    @override
    def templates(self) -> Iterable[tuple[Keys, object]]:
        return (*super().templates(), *((("with", name), value) for name, value in self.with_.items()))

    @override
    def words(self, show: Show) -> str:
        given = ", ".join(f"{name}={show(value)}" for name, value in self.with_.items())
        return f"python {self.python}({given})" + (f" -> {self.save_as}" if self.save_as else "")

    @override
    def attempt(self, action: StepAction) -> Coroutine:
        run, context = action.run, action.context
        action.is_begun = False
        names = yield from action.read((*self.with_.values(), self.timeout_s))
        given = {name: render(value, names) for name, value in self.with_.items()}
        limit_s = self.deadline_s(context, names) or run.clock.of_real(DEFAULT_TIMEOUT_S)
        answer = _Answer(self.python, run.clock, run.clock.now() + limit_s, run.loop)
        function = run.plan.python[self.python]
        step_context = _step_context(action, answer, dict(names.variables))
        action.is_begun = True
        context.task.touch(None)
        work = partial(contextvars.copy_context().run, _call, function, step_context, given, answer)
        thread = threading.Thread(target=work, name=f"python step {self.python}", daemon=True)
        run.threads = [*(one for one in run.threads if one.is_alive()), thread]
        run.clock.start(thread)
        yield from run.wait(context, answer)
        run.assign(context, self.save_as, _usable(answer.get(), answer))


class _Answer(Future[Any]):
    """The result of a function. When nobody waits for it any longer, the function's waits are interrupted."""

    def __init__(self, name: str, clock: Clock, deadline_s: float, loop: EventLoop) -> None:
        super().__init__(clock, deadline_s, loop)
        self.scope = CancelScope()
        self._name = name

    @override
    def _given_up(self) -> None:
        self.scope.cancel()

    @override
    def describe(self) -> str:
        return f"Python step '{self._name}'"


def _usable(value: Any, answer: _Answer) -> Any:
    """Return a result; raise ScenarioError if looking at it fails, as the records and expressions do."""
    try:
        as_json(to_record(value), ensure_ascii=False).encode()
    except Exception as error:  # an object may raise any exception, and text may hold half a character
        raise ScenarioError(f"{answer.describe()} returned what no variable can hold: {error_text(error)}") from error
    return value


def _step_context(action: StepAction, answer: Future[Any], variables: dict[str, Any]) -> StepContext:
    run, robot = action.run, action.context.robot_name

    def log(text: str) -> None:
        line = str(text)
        run.loop.post(lambda: run.log(robot, line))

    return StepContext(
        robots=run.handles(action.context),
        robot=robot,
        directory=run.folder,
        clock=run.clock,
        variables=variables,
        seed=run.seed,
        is_cancelled=answer.done,
        log=log,
        keeps_files=run.keeps_files,
    )


def _call(function: StepFunction, context: StepContext, given: dict[str, Any], answer: _Answer) -> None:
    try:
        with in_scope(answer.scope):
            answer.set(function(context, **given))
    except EALError as error:
        answer.set_exception(error)
    except BaseException as error:  # noqa: BLE001  # user code may raise anything, and the run waits for the answer
        get_logger(step=threading.current_thread().name).debug("the function raised", exc_info=error)
        answer.set_exception(ScenarioError(f"{answer.describe()} raised {error_text(error)}"))
