"""What a resource says of itself, as it arrives: checked field by field, since it comes from another machine."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from eal_actors.device.info import METHODS, ResourceInfo
from eal_actors.kernel.errors import ProtocolError


class _Fields(BaseModel):
    """Fields by name, without conversions; fields of later versions are passed over."""

    model_config = ConfigDict(strict=True, extra="ignore")


class _ValueFields(_Fields):
    type: str
    unit: str | None
    minimum: int | float | None
    maximum: int | float | None
    choices: list[str | bool | int | float]
    shape: list[int | None]
    description: str


class _CommandFields(_Fields):
    name: str
    argument: _ValueFields | None
    returns: _ValueFields | None
    urgent: bool
    description: str


class _ConfigFields(_Fields):
    name: str
    value: _ValueFields
    writable: bool
    description: str


class _InfoFields(_Fields):
    name: str = Field(min_length=1)
    types: list[str]
    methods: list[str]
    value: _ValueFields | None
    commands: list[_CommandFields]
    requests: list[_CommandFields]
    configs: list[_ConfigFields]
    description: str


def info_from(fields: object) -> ResourceInfo:
    """Rebuild what `ResourceInfo.to_dict` made at the other end; methods that are unknown here are left out.

    Raises:
        ProtocolError: a field is missing or of the wrong type.
    """
    try:
        checked = _InfoFields.model_validate(fields)
        checked.methods = [method for method in checked.methods if method in METHODS]
        return ResourceInfo.from_dict(checked.model_dump())
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"])) or "all of it"
        raise ProtocolError(f"information of a resource: {place}: {first['msg']}") from error
    except KeyError as error:
        raise ProtocolError(f"information of a resource: there is no type {error}") from error
