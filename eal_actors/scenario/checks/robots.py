"""What can be wrong with a scenario on the robots that will carry it out, found before anything moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from eal_actors.device.info import ResourceInfo, unknown_name
from eal_actors.kernel.errors import EALError, Problem
from eal_actors.kernel.yaml_tree import YamlPath, format_path
from eal_actors.scenario.checks.arguments import check_arguments, method_problem
from eal_actors.scenario.checks.facts import RobotFacts, kinds_of, shown_robots
from eal_actors.scenario.checks.fields import number_problem, static_numbers
from eal_actors.scenario.checks.here import Here, Place
from eal_actors.scenario.checks.saving import misfits
from eal_actors.scenario.checks.statics import (
    MAX_COMBINATIONS,
    MAX_IN_ALL,
    Guard,
    StaticLoop,
    Statics,
    TooManyCombinationsError,
)
from eal_actors.scenario.expressions import (
    Expression,
    Known,
    evaluate,
    expressions_in,
    parse_bare,
    parse_template,
    render,
    render_text,
)
from eal_actors.scenario.expressions.evaluation import plain
from eal_actors.scenario.files import check_file_name
from eal_actors.scenario.model import (
    INDEX,
    AnswerStep,
    AnyStep,
    CallStep,
    ForStep,
    IfStep,
    OnStep,
    ParallelStep,
    RepeatStep,
    ScenarioStep,
    SequenceStep,
    WhileStep,
    call_fields,
    inner_steps,
    resolved_fields,
)
from eal_actors.scenario.parameters import parameter_problem
from eal_actors.scenario.scenario import Scenario
from eal_actors.scenario.wording import Placed, step_expressions


def check_on_robots(
    scenario: Scenario,
    roles: Mapping[str, Sequence[str]],
    robots: Mapping[str, RobotFacts],
    *,
    spares: Mapping[str, Sequence[str]] | None = None,
    seed: int = 0,
) -> list[Problem]:
    """Return what the robots cannot do: every call, with every value of every loop around it.

    Only what depends on a value that comes up during the run stays unchecked.

    Args:
        scenario: a scenario without problems of its own.
        roles: the robots of each role.
        robots: what they can do; a robot that is missing here is passed over.
        spares: the robots that may take a place in each role.
        seed: of the fleet.
    """
    checker = _Checker(robots, roles, spares or {})
    everyone = {role: (*names, *(spares or {}).get(role, ())) for role, names in roles.items()}
    statics = Statics({**scenario.parameters, "run": {"seed": seed}})
    checker.visit_file(Here(scenario, everyone, statics))
    return checker.problems()


class _Checker:
    def __init__(
        self,
        robots: Mapping[str, RobotFacts],
        roles: Mapping[str, Sequence[str]],
        spares: Mapping[str, Sequence[str]],
    ) -> None:
        self._robots = robots
        self._spares = spares
        self._roles = roles
        self._kinds = kinds_of(robots)
        self._found: dict[tuple[int, YamlPath, str], tuple[Callable[[str], Problem], dict[str, None]]] = {}
        self._answers: dict[tuple[Any, ...], str | None] = {}
        self._spent = 0

    def problems(self) -> list[Problem]:
        """Return one problem for each place and message, naming the robots."""
        return [
            make(f"{shown_robots(robots)}: {message}" if robots else message)
            for (_, _, message), (make, robots) in self._found.items()
        ]

    def _report(
        self,
        here: Here,
        path: YamlPath,
        message: str,
        robots: Sequence[str] = (),
        inside: tuple[str, int] | None = None,
    ) -> None:
        def make(text: str) -> Problem:
            return here.scenario.problem(path, text, inside=inside)

        self._found.setdefault((id(here.scenario), path, message), (make, {}))[1].update(dict.fromkeys(robots))

    def visit_file(self, here: Here) -> None:
        """Check a scenario and its end."""
        self._visit_all(here.scenario.file.steps, ("steps",), here)
        self._visit_all(here.scenario.file.finally_, ("finally",), here)

    def _visit_all(self, steps: Sequence[AnyStep], path: YamlPath, here: Here) -> None:
        for index, step in enumerate(steps):
            self._visit(step, (*path, index), here)

    def _visit(self, step: AnyStep, path: YamlPath, here: Here) -> None:
        self._numbers(step, path, here)
        for placed in step_expressions(step):
            self._readings(placed, path, here)
            if not isinstance(step, CallStep):  # whose values are worked out together
                self._worked_out(placed, path, here)
        match step:
            case CallStep():
                self._call(step, path, here)
            case OnStep():
                self._visit_all(step.do, (*path, "do"), self._on(step, here))
            case ForStep() | RepeatStep() | WhileStep():
                self._visit_all(step.do, (*path, "do"), self._loop(step, path, here))
            case IfStep():
                condition, _ = parse_bare(step.if_)
                for keys, inner in inner_steps(step):
                    guard = Guard(condition, keys == ("then",))
                    self._visit_all(inner, (*path, *keys), replace(here, statics=here.statics.under(guard)))
            case ParallelStep() | SequenceStep():
                for keys, inner in inner_steps(step):
                    self._visit_all(inner, (*path, *keys), here)
            case ScenarioStep():
                self._part(step, path, here)

    def _on(self, step: OnStep, here: Here) -> Here:
        groups: dict[int, list[str]] = {}
        for robot in here.roles[step.on]:
            if robot in self._robots:
                groups.setdefault(self._kinds[robot], []).append(robot)
        statics = replace(here.statics, has_facts=True)
        return replace(here, groups=tuple(map(tuple, groups.values())), statics=statics, role=step.on)

    def _loop(self, step: ForStep | RepeatStep | WhileStep, path: YamlPath, here: Here) -> Here:
        values: Sequence[object] | Expression | None = None
        name = INDEX
        if isinstance(step, ForStep):
            name = step.variable
            values = self._list(step, (*path, "for", name), here)
        elif isinstance(step, RepeatStep):
            values = range(step.repeat) if isinstance(step.repeat, int) else self._times(step.repeat, here)
        statics = here.statics.within(StaticLoop(name, values))
        if isinstance(step, WhileStep):
            statics = statics.under(Guard(parse_bare(step.while_)[0], wanted=True))
        return replace(here, statics=statics)

    def _times(self, text: str, here: Here) -> Sequence[object] | None:
        """Return the numbers of a `repeat` whose count is an expression, where that is the same for everyone."""
        expression = parse_template(text).whole
        if expression is None or not here.statics.is_known(expression) or here.statics.needs_facts([expression]):
            return None
        counts = {evaluate(expression, known) for known in here.statics.combinations([expression])}
        return range(max((count for count in counts if isinstance(count, int)), default=0))

    def _list(self, step: ForStep, path: YamlPath, here: Here) -> Sequence[object] | Expression | None:
        values = step.values
        if isinstance(values, tuple) and not any(expressions_in(values)):
            return values
        expressions = list(expressions_in(values))
        if not all(here.statics.is_known(expression) for expression in expressions):
            return None
        if isinstance(values, tuple):
            return None if len(expressions) and here.statics.loops else self._rendered(values, expressions, path, here)
        for _, known in self._tries(expressions, path, here):
            try:
                found = plain(evaluate(expressions[0], known), "the list")
            except EALError as error:
                self._report(here, path, error.message)
                return None
            if not isinstance(found, list):
                self._report(here, path, f"${{{expressions[0].text}}} is no list, but {found!r}")
                return None
        return expressions[0]

    def _rendered(
        self, values: tuple[object, ...], expressions: list[Expression], path: YamlPath, here: Here
    ) -> Sequence[object] | None:
        if here.statics.needs_facts(expressions):
            return None
        try:
            return render(values, Known(here.statics.constants))  # type: ignore[return-value]  # a tuple stays one
        except EALError as error:
            self._report(here, path, error.message)
            return None

    def _tries(
        self, expressions: Sequence[Expression], path: YamlPath, here: Here
    ) -> list[tuple[tuple[str, ...], Known]]:
        """Return the robots and the values with which a step is tried; robots that are alike are tried together."""
        tries: list[tuple[tuple[str, ...], Known]] = []
        try:
            for robots, statics in self._per_robot(expressions, here):
                if self._spent > MAX_IN_ALL:
                    return []
                found = [(robots, known) for known in statics.combinations(expressions)]
                tries += found
                self._spent += max(0, len(found) - 1)
                if self._spent > MAX_IN_ALL:
                    message = f"up to here, loops give more than {MAX_IN_ALL} combinations; the rest was not checked"
                    self._report(here, path, message)
        except TooManyCombinationsError as error:
            message = f"the loops around this step give {error} combinations; at most {MAX_COMBINATIONS} can be checked"
            self._report(here, path, message)
        return tries

    def _per_robot(self, expressions: Sequence[Expression], here: Here) -> list[tuple[tuple[str, ...], Statics]]:
        if not here.groups:
            return [] if here.role else [((), here.statics)]
        if not here.statics.needs_facts(expressions):
            return [(robots, here.statics) for robots in here.groups]
        return [
            ((robot,), replace(here.statics, facts={"robot": robot, "role": here.role, "index": index, "count": count}))
            for robots in here.groups
            for robot in robots
            for index, count in self._places(robot, here)
        ]

    def _places(self, robot: str, here: Here) -> list[tuple[int, int]]:
        """Return the numbers that a robot may have in its role: a spare may come to any place."""
        if here.is_of_one:
            return [(0, 1)]
        everyone = here.roles[here.role]
        spares = {spare for names in self._spares.values() for spare in names}
        seated = [name for name in everyone if name not in spares]
        if robot in seated:
            return [(seated.index(robot), len(seated))]
        return [(index, len(seated)) for index in range(len(seated))]

    # Steps.

    def _numbers(self, step: AnyStep, path: YamlPath, here: Here) -> None:
        """Check the numbers of a step that are worked out, as far as they are known."""
        for keys, text, wanted in static_numbers(step):
            expressions = list(expressions_in(text))
            if not all(here.statics.is_known(expression) for expression in expressions):
                continue
            for robots, known in self._tries(expressions, (*path, *keys), here):
                try:
                    problem = number_problem(render(text, known), wanted)
                except EALError as error:
                    problem = error.message
                if problem is not None:
                    self._report(here, (*path, *keys), problem, robots if here.statics.facts else ())

    def _worked_out(self, placed: Placed, path: YamlPath, here: Here) -> None:
        """Check that an expression has a value, as far as it is known."""
        if not here.statics.is_known(placed.expression):
            return
        for robots, known in self._tries([placed.expression], (*path, *placed.keys), here):
            try:
                evaluate(placed.expression, known)
            except EALError as error:
                inside = (placed.text, placed.offset)
                self._report(here, (*path, *placed.keys), error.message, robots if here.statics.facts else (), inside)

    def _readings(self, placed: Placed, path: YamlPath, here: Here) -> None:
        """Check what an expression asks the robots for."""
        for reading, offset in placed.expression.readings:
            key = {"send_req": "req", "get_config": "key"}.get(reading.method)
            given = {key: reading.argument} if key is not None else {}
            place = Place((*path, *placed.keys), (placed.text, placed.offset + offset))
            for robots in here.groups:
                self._try_call(reading.method, reading.resource, given, (place, place, place), robots, here)

    def _call(self, step: CallStep, path: YamlPath, here: Here) -> None:
        fields = call_fields(step)
        expressions = list(expressions_in((step.arguments.resource, *fields.values())))
        saved = list(expressions_in(step.save)) if isinstance(step, AnswerStep) else []
        inside = (*path, step.kind)
        where = (
            Place((*inside, "resource")),
            Place(inside),
            Place((*inside, next(iter(fields), "resource"))),
        )
        is_known = all(here.statics.is_known(expression) for expression in expressions)
        known_only = expressions if is_known else list(expressions_in(step.arguments.resource))
        for robots, known in self._tries(known_only, path, here):
            try:
                resource = render_text(step.arguments.resource, known)
                resolved = resolved_fields(step, known) if is_known else None
            except EALError as error:
                self._report(here, where[2].path, error.message, robots)
                continue
            given = None if resolved is None else {name: value for name, value in resolved.items() if value is not None}
            info = self._try_call(step.kind, resource, given, where, robots, here)
            if info is not None and given is not None:
                for keys, problem in misfits(step, here.scenario.file, info, given):
                    self._report(here, (*path, *keys), problem, robots)
        if isinstance(step, AnswerStep) and step.save is not None and all(map(here.statics.is_known, saved)):
            self._file_names(step.save, saved, (*path, "save"), here)

    def _file_names(self, name: str, expressions: list[Expression], path: YamlPath, here: Here) -> None:
        for _, known in self._tries(expressions, path, here):
            try:
                check_file_name(render_text(name, known))
            except EALError as error:
                self._report(here, path, error.message)

    def _try_call(
        self,
        method: str,
        resource: str,
        given: Mapping[str, Any] | None,
        where: tuple[Place, Place, Place],
        robots: Sequence[str],
        here: Here,
    ) -> ResourceInfo | None:
        """Check a call of robots that are alike; return what the resource says of itself if there is nothing wrong."""
        facts = self._robots[robots[0]]
        info = facts.resources.get(resource)
        if info is None:
            for robot in robots:
                left_out = self._robots[robot].left_out
                message = unknown_name("resource", resource, facts.resources) + left_out
                self._report(here, where[0].path, message, [robot], where[0].inside)
            return None
        if (problem := method_problem(method, info)) is not None:
            self._report(here, where[1].path, problem, robots, where[1].inside)
            return None
        if given is None:
            return info
        key = (method, id(info), repr(given))
        if key not in self._answers:
            self._answers[key] = _argument_problem(method, info, given)
        if (wrong := self._answers[key]) is not None:
            self._report(here, where[2].path, wrong, robots, where[2].inside)
            return None
        return info

    def _part(self, step: ScenarioStep, path: YamlPath, here: Here) -> None:
        """Check a scenario that is carried out as a step."""
        part = here.scenario.parts[format_path(path)]
        constants: dict[str, object] = dict(part.parameters)
        for name, value in step.with_.items():
            at = (*path, "with", name)
            expressions = list(expressions_in(value))
            names = {found.name for expression in expressions for found in expression.names}
            constants.pop(name, None)
            if not names <= set(here.statics.constants) or any(expression.readings for expression in expressions):
                continue
            try:
                found = render(value, Known(here.statics.constants))
            except EALError as error:
                self._report(here, at, error.message)
                continue
            if (problem := parameter_problem(part.file.parameters[name], found)) is not None:
                self._report(here, at, problem)
            constants[name] = found
        own = here.role or None
        roles = {theirs: here.roles[own or step.roles.get(theirs, theirs)] for theirs in part.file.roles}
        statics = Statics({**constants, "run": here.statics.constants["run"]})
        self.visit_file(Here(part, roles, statics, is_of_one=here.is_of_one or own is not None))


def _argument_problem(method: str, info: ResourceInfo, given: Mapping[str, Any]) -> str | None:
    try:
        check_arguments(method, info, given)
    except EALError as error:
        return error.message
    return None
