"""A scenario file: its parameters, its roles, its steps."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, NonNegativeInt, PositiveFloat, PositiveInt

from eal_actors.kernel.strict_model import NAMES_ONLY, Name, StrictModel, Version1
from eal_actors.scenario.model.policies import OnFailure
from eal_actors.scenario.model.steps import MIN_ITEMS, NOT_EMPTY, AnyStep, Steps
from eal_actors.scenario.model.values import Scalars, Text, Value, VariableName

Words = Annotated[tuple[Text, ...], Field(strict=False, json_schema_extra=MIN_ITEMS), NOT_EMPTY]
ParameterType = Literal["int", "double", "bool", "string", "list"]


class ParameterSection(StrictModel):
    """A value that can be chosen when the scenario is run."""

    type: ParameterType
    unit: Text | None = None
    """Its unit, such as `m/s`, for people."""
    default: Value | None = None
    """Its value where none is given; without a default one must be given."""
    minimum: float | None = None
    maximum: float | None = None
    choices: Scalars = ()
    """The values it may have; empty for no such limit."""
    description: str = ""


class RoleSection(StrictModel):
    """Which robots of the fleet take the role: those that fit everything given, all if nothing is."""

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
    """With fewer robots the scenario does not start, and does not go on."""
    max: PositiveInt | None = None
    """At most so many take part: the first of the fleet file."""
    spares: NonNegativeInt = 0
    """So many of the others that fit are kept to take the place of one that fails."""
    on_failure: OnFailure | None = None
    """What happens when a step of its robots fails; the file's if left out."""


class ScenarioFile(StrictModel):
    """A scenario file."""

    version: Version1
    name: Name
    description: str = ""
    """One line for people."""
    parameters: dict[VariableName, ParameterSection] = Field(default={}, json_schema_extra=NAMES_ONLY)
    roles: dict[Name, RoleSection] = Field(min_length=1, json_schema_extra=NAMES_ONLY)
    timeout_s: PositiveFloat | None = None
    """Deadline of a call that gives none; the fleet file's if left out. In seconds of the fleet's clock."""
    on_failure: OnFailure = "abort"
    """What happens when a step fails."""
    safe_to_repeat: bool = False
    """A run that is resumed may repeat the step at which it was cut off."""
    steps: Steps
    finally_: Annotated[tuple[AnyStep, ...], Field(strict=False)] = Field(default=(), alias="finally")
    """Steps for the end, whatever came before it; all robots take part, and a failure stops none of them."""
