"""Answers made of what resources return: checked, and converted to the types of the resource API."""

from __future__ import annotations

import types
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from eal_actors.device.data import DataType, EALData, ValueInfo
from eal_actors.device.resource import Activity
from eal_actors.kernel.errors import EALError, ReturnTypeError

_FLOATS: Final = (DataType.FLOAT, DataType.DOUBLE)


class PendingResult(NamedTuple):
    """A result that an activity will return, and the function that makes the answer of it."""

    activity: Activity
    convert: Callable[[Any], Any]


def converted(result: Any, convert: Callable[[Any], Any]) -> Any:
    """Make the answer of a result; an activity gives its result later."""
    return PendingResult(result, convert) if type(result) is types.GeneratorType else convert(result)


def status_of(result: Any) -> int:
    """Return a status int, where None counts as 1, the thesis's success; or raise ReturnTypeError."""
    if not isinstance(result, int | None):
        raise ReturnTypeError(f"returned {result!r} where a status int is wanted")
    return 1 if result is None else int(result)


def data_of(result: Any, value: ValueInfo | None = None) -> EALData:
    """Return the result as EALData, checked against the resource's information, or raise ReturnTypeError.

    An int is converted where a float or double is declared, so that 60 and 60.0 are the same answer.
    """
    if type(result) is EALData:
        data = result
    else:
        if type(result) is int and value is not None and value.type in _FLOATS and not value.shape:
            result = float(result)
        try:
            data = EALData.of(result)
        except EALError as error:
            raise ReturnTypeError(f"returned what no EALData can hold: {error}") from error
    if value is not None and (problem := value.problem(data)):
        raise ReturnTypeError(f"returned a value that {problem}")
    return data
