"""The step `python`: run a Python function in a thread of its own."""

from __future__ import annotations

import contextvars
import importlib
import importlib.util
import inspect
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pydantic import Field
from typing_extensions import override

from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.errors import EALError, Problem, ScenarioError, error_text
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.strict_model import NAMES_ONLY
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.scenario.engine.executor import StepAction
from eal_actors.scenario.engine.loop import Coroutine, EventLoop
from eal_actors.scenario.language.expressions import render
from eal_actors.scenario.language.scenario import Scenario
from eal_actors.scenario.language.values import Text, Value, VariableName
from eal_actors.scenario.steps.base import Keys, Show, TimedStep

if TYPE_CHECKING:  # a plan has steps
    from eal_actors.device.info import ResourceInfo
    from eal_actors.scenario.engine.plan import Plan

GROUP: Final = "eal_actors.steps"
"""The group of entry points that hold functions for steps."""
DEFAULT_TIMEOUT_S: Final = 60.0
"""The deadline if neither the step nor the scenario has one, in real seconds."""
_JOIN_S: Final = 0.5
"""Real seconds that functions have to return after the run."""


@dataclass(frozen=True, slots=True)
class StepContext:
    """The first argument of the function of a Python step.

    Attributes:
        robots: the robots it may use, by name: the one of the `on` around it, or all that take part outside of one.
        robot: the robot of the `on` around it, or None.
        directory: the run's folder, for files of the step; None if nothing is kept. Files of a robot go into its
            folder there, `directory / robot`.
        clock: the fleet's clock.
        variables: the current variables of the scenario, by name; changes have no effect.
        seed: the fleet's seed, the source of all randomness.
        is_cancelled: returns whether the result is no longer needed: the deadline has passed, or the run was stopped.
            A long function must call it regularly, and return.
        log: sends a line of text to those who watch the run. Thread: the step's own; does not block.
    """

    robots: Mapping[str, RobotHandle]
    robot: str | None
    directory: Path | None
    clock: Clock
    variables: Mapping[str, Any]
    seed: int
    is_cancelled: Callable[[], bool]
    log: Callable[[str], None]


StepFunction = Callable[..., Any]
"""Called as `step(context, **with)`; its result is the step's value. With an attribute `safe_to_repeat = True`, a
resumed run calls it again if it was interrupted."""


class PythonStep(TimedStep):
    """Run a function of Python in a thread of its own."""

    kind = "python"
    python: Text
    """An entry point of the group `eal_actors.steps`, or `module:function` if the fleet file allows it."""
    with_: dict[VariableName, Value] = Field(default={}, alias="with", json_schema_extra=NAMES_ONLY)
    """The function's arguments by name."""
    save_as: VariableName | None = None
    """Variable for its result."""

    @override
    def may_repeat(self, plan: Plan, info: ResourceInfo | None, command: str | None) -> bool:
        return bool(getattr(plan.python.functions[self.python], "safe_to_repeat", False))

    @override
    def needs_everyone(self) -> bool:
        return True

    @override
    def templates(self) -> Iterable[tuple[Keys, object]]:
        return (*super().templates(), *((("with", name), value) for name, value in self.with_.items()))

    @override
    def assigned(self) -> Iterable[tuple[Keys, str | None]]:
        return ((("save_as",), self.save_as),)

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
        function = run.plan.python.functions[self.python]
        step_context = _step_context(action, answer, dict(names.variables))
        action.is_begun = True
        context.task.touch(None)
        work = partial(contextvars.copy_context().run, _call, function, step_context, given, answer)
        thread = threading.Thread(target=work, name=f"python step {self.python}", daemon=True)
        run.threads.append(thread)
        run.clock.start(thread)
        yield from run.wait(context, answer)
        run.assign(context, self.save_as, answer.get())


class _Answer(Future[Any]):
    """The result of a function."""

    def __init__(self, name: str, clock: Clock, deadline_s: float, loop: EventLoop) -> None:
        super().__init__(clock, deadline_s, loop)
        self._name = name

    @override
    def describe(self) -> str:
        return f"Python step '{self._name}'"


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
    )


def _call(function: StepFunction, context: StepContext, given: dict[str, Any], answer: Future[Any]) -> None:
    try:
        answer.set(function(context, **given))
    except EALError as error:
        answer.set_exception(error)
    except BaseException as error:  # noqa: BLE001  # user code may raise anything, and the run waits for the answer
        get_logger(step=threading.current_thread().name).debug("the function raised", exc_info=error)
        answer.set_exception(ScenarioError(f"{answer.describe()} raised {error_text(error)}"))


def join_threads(threads: Sequence[threading.Thread], clock: Clock) -> None:
    """Wait a little for the functions of a run that is over; log those that do not return."""
    alive = [thread for thread in threads if thread.is_alive()]
    if not alive:
        return
    end_s = REAL_TIME.now() + _JOIN_S
    with clock.outside():
        for thread in alive:
            thread.join(max(0.0, end_s - REAL_TIME.now()))
    for thread in alive:
        if thread.is_alive():
            get_logger(thread=thread.name).error("the function did not return after the run; its thread keeps running")


# The functions of a scenario, found before the run.


@dataclass(frozen=True, slots=True)
class PythonFunctions:
    """The functions of a scenario's Python steps.

    Attributes:
        functions: by their names in the scenario.
        problems: the problems of their names and arguments.
    """

    functions: Mapping[str, StepFunction] = field(default_factory=dict)
    problems: tuple[Problem, ...] = ()

    @classmethod
    def of(cls, scenario: Scenario, fleet: FleetConfig) -> PythonFunctions:
        """Find the functions that a scenario and its parts name, and check the arguments of the steps.

        It imports the modules of the functions, and so runs their code.
        """
        functions: dict[str, StepFunction] = {}
        wrong: dict[str, str] = {}
        problems: dict[Problem, None] = {}
        for owner, path, _, step in scenario.walk():
            if not isinstance(step, PythonStep):
                continue
            if step.python not in functions and step.python not in wrong:
                found = _find(step.python, fleet)
                if isinstance(found, str):
                    wrong[step.python] = found
                else:
                    functions[step.python] = found
            message = wrong.get(step.python) or _argument_problem(functions[step.python], step)
            if message is not None:
                problems[owner.problem((*path, "python"), message)] = None
        return cls(functions, tuple(problems))


def _find(name: str, fleet: FleetConfig) -> StepFunction | str:
    """Return a function, or the problem with its name."""
    known = {point.name: point for point in entry_points(group=GROUP)}
    try:
        if ":" not in name:
            if name not in known:
                hint = did_you_mean(name, [*known, *fleet.python_steps])
                return f"unknown Python step '{name}'{hint}; one of your own is written module:function"
            found = known[name].load()
        else:
            if name not in fleet.python_steps:
                return f"'{name}' is not among the python_steps that fleet '{fleet.name}' allows; add it there"
            module, _, function = name.partition(":")
            found = getattr(_module(module, fleet.source.parent), function)
    except Exception as error:  # noqa: BLE001  # importing user code may raise anything
        return f"'{name}' cannot be loaded: {error_text(error)}"
    return found if callable(found) else f"'{name}' is no function"


def _module(name: str, folder: Path) -> Any:
    """Import a module: the one beside the fleet file if there is one, otherwise an installed one."""
    file = folder / f"{name}.py"
    if "." in name or not file.is_file():
        return importlib.import_module(name)
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file} is no module")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _argument_problem(function: StepFunction, step: PythonStep) -> str | None:
    """Return why a function does not take the arguments of a step, or None."""
    try:
        inspect.signature(function).bind(None, **dict.fromkeys(step.with_))
    except TypeError as error:
        return f"'{step.python}' does not take these arguments: {error}"
    except ValueError:  # a function without a signature
        return None
    return None
