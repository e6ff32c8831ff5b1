"""A scenario: its file as models, with the positions of all values in the text."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Generator, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, TypeAlias, get_args

from pydantic import Field, NonNegativeFloat, PositiveFloat

from eal_actors.device.info import ResourceInfo
from eal_actors.kernel.errors import Problem
from eal_actors.kernel.strict_model import NAMES_ONLY, DeferredType, Name, StrictModel, Version1
from eal_actors.kernel.suggestions import nearest
from eal_actors.kernel.yaml_tree import Mark, YamlPath, YamlTree, format_path, parse_path
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.scenario.engine.python_functions import StepFunction
from eal_actors.scenario.language.expressions.evaluation import LocatedExpression, locate_expressions
from eal_actors.scenario.language.sections import ParameterSection, RoleSection
from eal_actors.scenario.language.values import MIN_ITEMS, NOT_EMPTY, Held, OnFailure, OnLost, VariableName, Wanted
from eal_actors.scenario.language.wording import show_value

_DIGIT: Final = re.compile(r"\d")
_NUMBERS: Final[Mapping[str, Wanted]] = {wanted: wanted for wanted in get_args(Wanted)}


Keys: TypeAlias = tuple[str | int, ...]
"""The keys from a step to one of its values."""
RobotsByRole: TypeAlias = Mapping[str, Sequence[str]]
Show: TypeAlias = Callable[[object], str]
"""Returns a value for people, with the values of parameters inserted."""


class Step(StrictModel):
    """A step of a scenario.

    Attributes:
        kind: the key that names the kind; a kind gives it as `class NapStep(Step, kind="nap_s")`.
        is_expectation: it checks the run, so that its failure is a result.
        moves_its_role: it moves all robots of a role by one call of each.
        holds: what its own fields hold that have to do with expressions; those of its bases are added.
    """

    kind: ClassVar[str]
    is_expectation: ClassVar[bool] = False
    moves_its_role: ClassVar[bool] = False
    holds: ClassVar[Mapping[str, Held]] = {}

    safe_to_repeat: bool | None = None
    """For steps of the top level: a resumed run may repeat the step; defaults to that of the file."""
    lost_after_s: NonNegativeFloat | None = None
    """Time out of reach after which the step of a robot fails, in seconds of the fleet's clock; also for the steps
    inside; defaults to that of the block around it, or of the file."""

    def __init_subclass__(cls, *, kind: str = "", **config: Any) -> None:
        super().__init_subclass__(**config)
        if kind:
            cls.kind = kind

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

    def may_repeat(self, functions: Mapping[str, StepFunction], info: ResourceInfo | None, command: str | None) -> bool:
        """Return whether performing the step again, after it was interrupted, leads to the same state as once.

        `functions` are those of Python steps, by name; `info` and `command` are the resource and the text of a call.
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

    def meeting(self, frame: Hashable) -> Hashable | None:
        """Return the key of the meeting that the step takes part in while a scenario is under way, or None."""
        return None

    # Expressions.

    def templates(self) -> Iterable[tuple[Keys, object]]:
        """Return the values of the step that may hold `${...}`."""
        return [(keys, value) for keys, value, held in self._held() if held == "template" or held in _NUMBERS]

    def conditions(self) -> Iterable[tuple[Keys, object]]:
        """Return the values of the step that are expressions without `${}`."""
        return [(keys, value) for keys, value, held in self._held() if held == "condition"]

    def numbers(self) -> Iterable[tuple[Keys, object, Wanted]]:
        """Return those of the templates that must be numbers, with their ranges."""
        return [(keys, value, _NUMBERS[held]) for keys, value, held in self._held() if held in _NUMBERS]

    def assigned(self) -> Iterable[tuple[Keys, str | None]]:
        """Return the variables that the step assigns."""
        return [(keys, value) for keys, value, held in self._held() if held == "variable"]

    def _held(self) -> Iterator[tuple[Keys, Any, Held]]:
        for name, key, held in _held_by(type(self)):
            yield (key,), getattr(self, name), held

    def expressions(self) -> Iterator[LocatedExpression]:
        """Yield the expressions of the step, without those of the steps inside it."""
        for keys, value in self.templates():
            yield from locate_expressions(keys, value)
        for keys, value in self.conditions():
            yield from locate_expressions(keys, value, is_bare=True)

    def shared_robots(self, scenario: Scenario, path: YamlPath, roles: RobotsByRole) -> Iterator[Problem]:
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

    # Planning.

    def passes(self, scenario: Scenario) -> int | None:
        """Return how often the steps inside run; None if that is known only during the run."""
        return 1

    def own_calls(self, robots: int) -> int:
        """Return the number of calls that the step itself makes with so many robots."""
        return 0

    def count_calls(self, scenario: Scenario, path: YamlPath, robots: int | None, live: Mapping[str, int]) -> int:
        """Return the number of calls if nothing fails, as far as it is known.

        `robots` is the number of robots of the `on` around the step, None outside of `on`; `live` is that of each role.
        """
        count = self.own_calls(robots or 0)
        passes = self.passes(scenario)
        for keys, steps in self.children() if passes else ():
            count += (passes or 0) * scenario.count_calls(steps, (*path, *keys), robots, live)
        return count

    # Visits. Each kind of visitor has a type that imports this module; `StepKind` states it.

    def check(self, check: Any, path: YamlPath, scope: Any) -> None:
        """Check the step against its surroundings, and then the steps inside it."""
        raise NotImplementedError

    def check_robots(self, check: Any, path: YamlPath, here: Any) -> None:
        """Check the step, and the steps inside it, on the robots that come to it."""
        raise NotImplementedError

    def timeline(self, builder: Any, path: YamlPath, robots: tuple[str, ...]) -> Any:
        """Return the robots of the step's timeline entry, and the entries inside it."""
        raise NotImplementedError

    def perform(self, run: Any, context: Any, path: str) -> Generator[Any, None, None]:
        """Perform the step for the robot of a context, or for none outside of `on`. Thread: the run's own."""
        raise NotImplementedError


@cache
def _held_by(kind: type[Step]) -> tuple[tuple[str, str, Held], ...]:
    """Return what the fields of a kind hold, with their keys in the file, those of its bases first."""
    held: dict[str, Held] = {}
    for base in reversed(kind.__mro__):
        held |= vars(base).get("holds", {})
    return tuple((name, kind.model_fields[name].alias or name, what) for name, what in held.items())


class FallibleModel(Step):
    """A step that can fail, as in the file.

    If it `is_instant`, it takes no time, and only its failure is recorded. If it `meets_again`, a resumed run performs
    it again although it was over.
    """

    is_instant: ClassVar[bool] = False
    meets_again: ClassVar[bool] = False

    on_failure: OnFailure | None = None
    """The policy if it fails; defaults to that of the block around it, of the role or of the file."""


_step_union: list[Callable[[], object]] = []


def use_step_kinds(union: Callable[[], object]) -> None:
    """Set the function that returns the union of all kinds of steps: their modules import this one."""
    _step_union[:] = [union]


AnyStep: TypeAlias = Annotated[Step, DeferredType(lambda: _step_union[0]())]
"""A step in a file. Its type is the union of all kinds, which is built when the first file is read."""
Steps: TypeAlias = Annotated[tuple[AnyStep, ...], Field(strict=False, json_schema_extra=MIN_ITEMS), NOT_EMPTY]


class ScenarioFile(StrictModel):
    """A scenario file."""

    version: Version1
    name: Name
    description: str = ""
    """One line for people."""
    parameters: dict[VariableName, ParameterSection] = Field(default={}, json_schema_extra=NAMES_ONLY)
    roles: dict[Name, RoleSection] = Field(default={}, json_schema_extra=NAMES_ONLY)
    """The robots that take part; an `on` may also name a robot."""
    timeout_s: PositiveFloat | None = None
    """Default deadline of a call, in seconds of the fleet's clock; defaults to that of the fleet file."""
    on_failure: OnFailure = "abort"
    """The policy when a step fails."""
    on_lost: OnLost | None = None
    """The policy when a robot is lost; defaults to `on_failure`."""
    lost_after_s: NonNegativeFloat | None = None
    """Time out of reach after which a robot's step fails, in seconds of the fleet's clock; defaults to the fleet's."""
    safe_to_repeat: bool | None = None
    """A resumed run repeats the step of the top level at which it was interrupted, from its beginning; with `false` it
    refuses to. By default it continues inside that step, if the steps that were under way do no harm when repeated."""
    steps: Steps
    finally_: Annotated[tuple[AnyStep, ...], Field(strict=False)] = Field(default=(), alias="finally")
    """Steps for the end, whatever happened before. All robots take part, and a failure stops none of them."""

    def is_safe(self, index: int) -> bool | None:
        """Return whether a top-level step may be repeated from its beginning; None if its own steps decide."""
        own = self.steps[index].safe_to_repeat
        return self.safe_to_repeat if own is None else own

    @property
    def keeps_checkpoints(self) -> bool:
        """Whether a run of the scenario can be resumed after an interruption."""
        return any(self.is_safe(index) is not False for index in range(len(self.steps)))

    def walk(self) -> Iterator[tuple[YamlPath, Step]]:
        """Yield all steps with their paths, each before the steps inside it."""
        yield from _walk(self.steps, ("steps",))
        yield from _walk(self.finally_, ("finally",))


def _walk(steps: Sequence[Step], path: YamlPath) -> Iterator[tuple[YamlPath, Step]]:
    for index, step in enumerate(steps):
        here = (*path, index)
        yield here, step
        for keys, inner in step.children():
            yield from _walk(inner, (*here, *keys))


@dataclass(frozen=True, slots=True)
class Scenario:
    """A scenario that passed all checks that need no fleet.

    Attributes:
        source: the file it was read from, as the user gave it.
        tree: the same, with positions in the file.
        parameters: the values of its parameters, defaults included; required ones without a value are missing.
        parts: the scenarios that its steps run, by the path of the step.
        named: the robots that its steps name; each is a role of its own, with the path of its first step.
        size: the number of its steps, those of its parts included.
    """

    source: Path
    file: ScenarioFile
    tree: YamlTree
    lines: tuple[str, ...] = ()
    parameters: Mapping[str, object] = field(default_factory=dict)
    parts: Mapping[str, Scenario] = field(default_factory=dict)
    named: Mapping[str, YamlPath] = field(default_factory=dict)
    size: int = 0

    @property
    def name(self) -> str:
        """The scenario's name."""
        return self.file.name

    def problem(
        self, path: YamlPath, message: str, *, key: bool = False, inside: tuple[str, int] | None = None
    ) -> Problem:
        """Return a problem with the value at a path, with its key, or at an offset inside the value, a text."""
        mark = self.tree.mark_at(path, key=key)
        shift = 0 if inside is None else self._column_shift(mark, *inside)
        return Problem(mark.file, mark.line, mark.column + shift, format_path(path), message)

    def _column_shift(self, mark: Mark, text: str, offset: int) -> int:
        """Return the columns from a text's beginning to an offset; 0 where the file spells the text differently."""
        if not 0 < mark.line <= len(self.lines):
            return 0
        written = self.lines[mark.line - 1][mark.column - 1 :]
        quote = written[:1] in ("'", '"')
        if not written[quote:].startswith(text[: offset + 1]):  # escapes, or a text of several lines
            return 0
        return quote + offset

    def with_named_robots(self) -> Scenario:
        """Return the scenario with a role for each robot that its steps, or those of its parts, name."""
        named: dict[str, YamlPath] = {}
        for path, step in self.file.walk():
            part = self.parts.get(format_path(path))
            for name in [step.own_role] if part is None else part.named:
                if name is not None and self._is_robot(name):
                    named.setdefault(name, path)
        roles = {**self.file.roles, **{name: RoleSection(robots=(name,)) for name in named}}
        return replace(self, file=self.file.model_copy(update={"roles": roles}), named=named)

    def _is_robot(self, name: str) -> bool:
        """Return whether a name is no role, nor a misspelt one: `scout-1` is a robot, `scuots` the role `scouts`."""
        near = nearest(name, self.file.roles)
        return name not in self.file.roles and (near is None or bool(_DIGIT.search(name)) > bool(_DIGIT.search(near)))

    def role_problem(self, role: str, keys: YamlPath, message: str, *, key: bool = False) -> Problem:
        """Return a problem of a role at some keys of it, or at the step that names a robot."""
        if role in self.named:
            return self.problem(
                (*self.named[role], "on"), f"there is no role {role!r}, so it is a robot, and {message}"
            )
        return self.problem(("roles", role, *keys), message, key=key)

    def walk(self) -> Iterator[tuple[Scenario, YamlPath, str, Step]]:
        """Yield all steps, those of its parts included: the scenario, the path in it, the path in records, the step."""
        for path, step in self.file.walk():
            name = format_path(path)
            yield self, path, name, step
            if (part := self.parts.get(name)) is not None:
                for owner, inner, inner_name, step_of_part in part.walk():
                    yield owner, inner, f"{name}.{part.name}.{inner_name}", step_of_part

    def roles_at_work(self, steps: Sequence[Step], path: YamlPath, first: int = 0) -> Iterator[str]:
        """Yield the roles at work in some of its steps, from the first that counts, by their names in it."""
        for index, step in enumerate(steps[first:], first):
            yield from step.roles_at_work(self, (*path, index))

    def shared_robots(self, roles: RobotsByRole) -> Iterator[Problem]:
        """Yield a problem for each robot that two branches of a block would use at the same time."""
        for key, steps in (("steps", self.file.steps), ("finally", self.file.finally_)):
            for index, step in enumerate(steps):
                yield from step.shared_robots(self, (key, index), roles)

    def count_calls(self, steps: Sequence[Step], path: YamlPath, robots: int | None, live: Mapping[str, int]) -> int:
        """Return the number of calls of some of its steps; see `Step.count_calls`."""
        return sum(step.count_calls(self, (*path, index), robots, live) for index, step in enumerate(steps))

    def expectations(self) -> tuple[str, ...]:
        """Return the paths in records of all steps that check the run."""
        return tuple(name for _, _, name, step in self.walk() if step.is_expectation)

    def position_of(self, step: str) -> Mark:
        """Return the position of a step in its file, by its path in records, such as `steps[0].do[1]`."""
        for path, part in self.parts.items():
            prefix = f"{path}.{part.name}."
            if step.startswith(prefix):
                return part.position_of(step.removeprefix(prefix))
        return self.tree.mark_at(parse_path(step))


def scenario_hash(scenario: Scenario) -> str:
    """Return the SHA-256 of the content of a scenario and its parts, in hexadecimal."""
    digest = hashlib.sha256(scenario.file.model_dump_json().encode())
    for path in sorted(scenario.parts):
        digest.update(f"{path}:{scenario_hash(scenario.parts[path])}".encode())
    return digest.hexdigest()
