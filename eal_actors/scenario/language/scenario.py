"""A scenario: its file as models, with the positions of all values in the text."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt

from eal_actors.kernel.errors import Problem
from eal_actors.kernel.strict_model import NAMES_ONLY, Name, StrictModel, Version1
from eal_actors.kernel.suggestions import nearest
from eal_actors.kernel.yaml_tree import Mark, YamlPath, YamlTree, format_path
from eal_actors.scenario.language.values import (
    MIN_ITEMS,
    NOT_EMPTY,
    OnFailure,
    OnLost,
    Scalars,
    Text,
    Value,
    VariableName,
)
from eal_actors.scenario.steps.base import AnyStep, Step, Steps

_ELEMENT: Final = re.compile(r"\[(\d+)\]|([^.\[\]]+)")
_DIGIT: Final = re.compile(r"\d")
Words = Annotated[tuple[Text, ...], Field(strict=False, json_schema_extra=MIN_ITEMS), NOT_EMPTY]
ParameterType = Literal["int", "double", "bool", "string", "list"]


class ParameterSection(StrictModel):
    """A value that can be chosen when the scenario is run."""

    type: ParameterType
    unit: Text | None = None
    """Its unit, such as `m/s`, for people."""
    default: Value | None = None
    """Its value if none is given. Without a default, a value must be given."""
    minimum: float | None = None
    maximum: float | None = None
    choices: Scalars = ()
    """The allowed values; empty for no such limit."""
    description: str = ""


class RoleSection(StrictModel):
    """The robots of the fleet that take the role: those that fit all criteria, or all robots without any."""

    tags: Words | None = None
    """They have one of these tags."""
    types: Words | None = None
    """Their type is, or builds on, one of these."""
    robots: Words | None = None
    """They have one of these names."""
    needs: dict[Name, Annotated[tuple[Text, ...], Field(strict=False)]] = Field(
        default={}, json_schema_extra=NAMES_ONLY
    )
    """They have these resources, and each resource these commands."""
    min: NonNegativeInt = 1
    """With fewer robots the scenario does not start, and does not continue."""
    max: PositiveInt | None = None
    """At most so many take part: the first of the fleet file."""
    spares: NonNegativeInt = 0
    """So many of the other robots that fit are kept in reserve for one that fails."""
    on_failure: OnFailure | None = None
    """The policy when a step of its robots fails; defaults to that of the file."""
    on_lost: OnLost | None = None
    """The policy when one of its robots is lost; defaults to that of the file."""


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
        file: its content.
        tree: the same, with positions in the file.
        lines: the file's lines.
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
        """Return a problem at a position of the file.

        Args:
            path: of a value, from the top of the file.
            message: the text of the problem.
            key: the problem is with the key, not with the value.
            inside: the value, a text, and the offset of the problem in it.
        """
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
        """Yield the roles at work in some of its steps, by their names in it.

        Args:
            steps: the steps.
            path: their path.
            first: index of the first step that counts.
        """
        for index, step in enumerate(steps[first:], first):
            yield from step.roles_at_work(self, (*path, index))

    def shared_robots(self, roles: Mapping[str, Sequence[str]]) -> Iterator[Problem]:
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
        """Return the position of a step in its file.

        Args:
            step: its path in records, such as `steps[0].do[1]`; inside a part, behind the path of the step that runs
                the part.
        """
        for path, part in self.parts.items():
            prefix = f"{path}.{part.name}."
            if step.startswith(prefix):
                return part.position_of(step.removeprefix(prefix))
        return self.tree.mark_at(parse_path(step))


def parse_path(text: str) -> YamlPath:
    """Return the path of a text such as `steps[0].do[1]`; the opposite of `format_path`."""
    return tuple(int(index) if index else name for index, name in _ELEMENT.findall(text))


def scenario_hash(scenario: Scenario) -> str:
    """Return the SHA-256 of the content of a scenario and its parts, in hexadecimal."""
    digest = hashlib.sha256(scenario.file.model_dump_json().encode())
    for path in sorted(scenario.parts):
        digest.update(f"{path}:{scenario_hash(scenario.parts[path])}".encode())
    return digest.hexdigest()
