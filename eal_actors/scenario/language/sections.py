"""The parameters and the roles of a scenario file, as models."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, NonNegativeInt, PositiveInt

from eal_actors.kernel.strict_model import NAMES_ONLY, Name, StrictModel
from eal_actors.scenario.language.values import MIN_ITEMS, NOT_EMPTY, OnFailure, OnLost, Scalars, Text, Value

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
