"""The family of calls: what the ten methods in `calls` have in common."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from typing_extensions import override

from eal_actors.actors.call import Call
from eal_actors.actors.future import Future
from eal_actors.device.data import EALData
from eal_actors.device.info import ResourceInfo, ValueInfo
from eal_actors.kernel.errors import EALError, ScenarioError
from eal_actors.kernel.strict_model import StrictModel
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.engine.action import StepAction
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.executor import perform_step
from eal_actors.scenario.engine.frames import ExecutionContext, Participant
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.engine.python_functions import StepFunction
from eal_actors.scenario.engine.synchronized_start import SynchronizedStart, join_start
from eal_actors.scenario.language.expressions.evaluation import Namespace, expressions_in, render, render_text
from eal_actors.scenario.language.parameters import unit_of, unit_problem
from eal_actors.scenario.language.robot_check import CheckedCall, Location, RobotCheck, RobotScope
from eal_actors.scenario.language.scenario import Keys, ScenarioFile, Show
from eal_actors.scenario.language.scope import Scope, ScopeCheck
from eal_actors.scenario.language.values import Text, VariableName
from eal_actors.scenario.report.files import answer_problem, check_file_name, name_problems, save_answer
from eal_actors.scenario.steps.base import TimedStep

TEXT_FIELDS: Final = ("cmd", "req", "key")
"""The arguments that methods take as texts, even if they look like numbers."""
_CONSUMING: Final = ("read_comm", "write_comm")
"""Methods whose second call has another effect than the first; those of send_cmd are declared."""


class ResourceArguments(StrictModel):
    """The arguments of a call: the resource, and those of the method under the API's names."""

    resource: Text
    """Name of the resource on the robot."""


class CallStep(TimedStep):
    """A call of one robot's resource; the step is over when it is answered."""

    @property
    def arguments(self) -> ResourceArguments:
        """The arguments of the call."""
        found: ResourceArguments = getattr(self, self.kind)
        return found

    @property
    def method(self) -> str:
        """The method that is called."""
        return self.kind

    @property
    def is_together(self) -> bool:
        """Whether all robots of the `on` begin it at the same time."""
        return bool(getattr(self, "together", False))

    @property
    def answer_file(self) -> str | None:
        """The file for the answer, in the robot's folder."""
        return getattr(self, "save", None)

    @property
    def answer_variable(self) -> str | None:
        """The variable for the answer."""
        return getattr(self, "save_as", None)

    def fields(self) -> dict[str, Any]:
        """Return the method's arguments without the resource, by the API's names and in its order."""
        arguments = self.arguments
        return {name: getattr(arguments, name) for name in type(arguments).model_fields if name != "resource"}

    def resolved_fields(self, names: Namespace) -> dict[str, Any]:
        """Return the arguments of the method's call, with the expressions evaluated; raise as `render` does."""
        return {
            name: render_text(value, names) if name in TEXT_FIELDS else render(value, names)
            for name, value in self.fields().items()
        }

    def begin(
        self, run: RunContext, robot: Participant, resource: str, fields: Mapping[str, Any], timeout_s: float | None
    ) -> Future[Any]:
        """Begin the call and return its answer; raise EALError without the resource, or for wrong arguments."""
        answer: Future[Any] = getattr(robot.handle[resource], self.method)(**fields, timeout_s=timeout_s)
        return answer

    def call_words(self, resource: str, fields: Mapping[str, Any]) -> str:
        """Return a call as one line of a report; values that need readings are as written."""
        return " ".join([self.kind, resource, *(str(value) for value in fields.values() if value is not None)])

    @override
    def may_repeat(self, functions: Mapping[str, StepFunction], info: ResourceInfo | None, command: str | None) -> bool:
        if self.method != "send_cmd":
            return self.method not in _CONSUMING
        try:
            return info is not None and info.parse_command(command or "", None)[0].repeatable
        except EALError:  # it needs its data, or there are no commands to look up
            return info is not None and any(one.name == command and one.repeatable for one in info.commands)

    @property
    @override
    def saves_files(self) -> bool:
        return self.answer_file is not None

    @override
    def meeting(self, frame: Hashable) -> Hashable | None:
        return (frame, id(self)) if self.is_together else None

    @override
    def templates(self) -> Iterable[tuple[Keys, object]]:
        found = {"resource": self.arguments.resource, **self.fields()}
        values = (((self.kind, name), value) for name, value in found.items())
        return (*super().templates(), *values, (("save",), self.answer_file))

    @override
    def assigned(self) -> Iterable[tuple[Keys, str | None]]:
        return ((("save_as",), self.answer_variable),)

    # Checks.

    @override
    def check_placement(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        super().check_placement(check, path, scope)
        if scope.role is None:
            check.report((*path, self.kind), f"which robot? '{self.kind}' must be in the 'do' of an 'on'", key=True)

    @override
    def check_values(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        check.template(self.arguments.resource, (*path, self.kind, "resource"), scope, static="the resource")
        if self.answer_file is not None:
            used = {name.name for expression in expressions_in(self.answer_file) for name in expression.names}
            loops = [(loop.name, loop.passes) for loop in scope.around]
            for problem in name_problems(self.answer_file, used - scope.facts - check.constants, loops):
                check.report((*path, "save"), problem)
        super().check_values(check, path, scope)

    @override
    def check_robots(self, check: RobotCheck, path: YamlPath, here: RobotScope) -> None:
        self.check_numbers(check, path, here)
        self._check_calls(check, path, here)
        if self.answer_file is not None:
            self._check_file_names(check, self.answer_file, (*path, "save"), here)

    def _check_calls(self, check: RobotCheck, path: YamlPath, here: RobotScope) -> None:
        """Check the call with all values that its arguments can have, and on all robots."""
        fields, resource = self.fields(), self.arguments.resource
        expressions = expressions_in((resource, *fields.values()))
        resource_at, method_at = Location((*path, self.kind, "resource")), Location((*path, self.kind))
        arguments_at = Location((*path, self.kind, next(iter(fields), "resource")))
        is_known = here.are_known(expressions)
        known_only = expressions if is_known else expressions_in(resource)
        for robots, names in check.combinations(known_only, path, here):
            try:
                name = render_text(resource, names)
                resolved = self.resolved_fields(names) if is_known else None
            except EALError as error:
                check.report(here, arguments_at.path, error.message, robots)
                continue
            given = None if resolved is None else {key: value for key, value in resolved.items() if value is not None}
            call = CheckedCall(self.method, name, given, resource_at, method_at, arguments_at)
            info = check.call(call, robots, here)
            if info is not None and given is not None:
                for keys, problem in self._misfits(here.scenario.file, info, given):
                    check.report(here, (*path, *keys), problem, robots)

    def _check_file_names(self, check: RobotCheck, name: str, path: YamlPath, here: RobotScope) -> None:
        expressions = expressions_in(name)
        if not here.are_known(expressions):
            return
        for _, names in check.combinations(expressions, path, here):
            try:
                check_file_name(render_text(name, names))
            except EALError as error:
                check.report(here, path, error.message)

    def _misfits(self, file: ScenarioFile, info: ResourceInfo, given: Mapping[str, Any]) -> Iterator[tuple[Keys, str]]:
        """Yield what does not fit in a valid call: units, and the answer's file."""
        for name in ("value", "data", "cmd"):
            value = self.fields().get(name)
            if unit_of(value, file) is not None:
                taker = _taker(self.method, info, given)
                what = f"{info.name} {given.get('cmd') or given.get('key') or self.kind}"
                wrong = unit_problem(value, file, taker.unit if taker is not None else None, what)
                if wrong is not None:
                    yield (self.kind, name), wrong
                break
        if self.answer_file is not None:
            answer = _answer_info(self.method, info, given)
            if answer is not None and (problem := answer_problem(self.answer_file, answer)) is not None:
                yield ("save",), problem

    # Wording, planning and execution.

    @override
    def words(self, show: Show) -> str:
        values = (value for value in self.fields().values() if value is not None)
        words = [self.kind, show(self.arguments.resource), *map(show, values)]
        if self.answer_file is not None:
            words.append(f"-> {show(self.answer_file)}")
        if self.answer_variable is not None:
            words.append(f"-> {self.answer_variable}")
        return " ".join(words) + (", together" if self.is_together else "")

    @override
    def own_calls(self, robots: int) -> int:
        return robots

    @override
    def perform(self, run: RunContext, context: ExecutionContext, path: str) -> Coroutine:
        make = partial(_CallAction, run, context, self, path, _TogetherState())
        yield from perform_step(run, context, self, path, make)


class StartStep(CallStep):
    """A call that can begin at an agreed time."""

    together: bool = False
    """All robots of the `on` meet, and begin it at the same time."""


class AnswerStep(CallStep):
    """A call that is answered with a value."""

    save_as: VariableName | None = None
    """Variable for the answer, for the later steps of the same role."""
    save: Text | None = None
    """File for the answer, in the robot's folder of the run directory; its suffix sets the format."""


def _taker(method: str, info: ResourceInfo, given: Mapping[str, Any]) -> ValueInfo | None:
    """Return the description of the value that a call takes."""
    if method == "set_value":
        return info.value
    if method == "set_config" and info.configs:
        return info.config(str(given["key"])).value
    if method == "send_cmd" and info.commands:
        data = EALData.of(given["data"]) if "data" in given else None
        return info.parse_command(str(given["cmd"]), data)[0].argument
    return None


def _answer_info(method: str, info: ResourceInfo, given: Mapping[str, Any]) -> ValueInfo | None:
    """Return the description of the answer to a valid call, or None without one."""
    if method == "get_value":
        return info.value
    if method == "send_req" and info.requests:
        return info.parse_request(str(given["req"]))[0].returns
    if method == "get_config" and info.configs:
        return info.config(str(given["key"])).value
    return None


@dataclass
class _TogetherState:
    """Whether a step with `together` has met the others: another attempt, or a spare, begins alone."""

    has_met: bool = False


class _CallAction(StepAction):
    """A call as one robot makes it."""

    def __init__(
        self, run: RunContext, context: ExecutionContext, step: CallStep, path: str, together: _TogetherState
    ) -> None:
        super().__init__(run, context, step.kind, lambda _: self._call())
        self.is_begun = False
        self._step = step
        self._path = path
        self._together = together
        self._fields = step.fields()
        self._expressions = list(
            expressions_in((step.arguments.resource, *self._fields.values(), step.timeout_s, step.answer_file))
        )
        try:
            self._describe(run.namespace(context))
        except EALError:  # it needs readings, or its evaluation will fail
            self._set(step.arguments.resource, self._fields)

    def _describe(self, names: Namespace) -> None:
        self._set(render_text(self._step.arguments.resource, names), self._step.resolved_fields(names))

    def _set(self, resource: str, fields: dict[str, Any]) -> None:
        self.resource, self._fields = resource, fields
        self.command = next((fields[name] for name in TEXT_FIELDS if name in fields), None)
        self.label = self._step.call_words(resource, fields)

    def _call(self) -> Coroutine:
        run, context, step = self.run, self.context, self._step
        names = yield from run.read(context, self._expressions)
        if self._expressions:
            self._describe(names)
        timeout_s = step.deadline_s(context, names)
        robot = context.required_robot
        resource = self.resource or ""
        start: SynchronizedStart | None = None
        if step.is_together and not self._together.has_met and not run.has_met_before(context, self._path):
            key = step.meeting(context.frame)
            if not context.task.had_met(key):
                start = yield from join_start(run, context, step, self._path)
            context.task.note_meeting(key)
            self._together.has_met = True
        self.is_begun = True
        context.task.touch(self.resource)
        future: Future[Any] | None = None
        try:
            if start is None:
                future = step.begin(run, robot, resource, self._fields, timeout_s)
            else:
                future = start.begin(getattr(robot.handle[resource], step.method), self._fields, timeout_s)
            yield from run.wait(context, future)
        finally:
            if start is not None:
                self.began_s = start.end(robot, future if isinstance(future, Call) else None)
        self.answer = future.get()
        run.assign(context, step.answer_variable, self.answer)
        if step.answer_file is not None and run.folder is not None:
            self._save(robot, render_text(step.answer_file, names if self._expressions else run.namespace(context)))

    def _save(self, robot: Participant, name: str) -> None:
        run = self.run
        assert run.folder is not None  # noqa: S101  # the caller has checked it
        try:
            note = save_answer(self.answer, run.folder / robot.name, name, run.now_s(), is_kept=run.keeps_files)
        except OSError as error:
            raise ScenarioError(f"could not save {name!r}: {error}") from error
        if note is not None:
            run.log(robot.name, note)
