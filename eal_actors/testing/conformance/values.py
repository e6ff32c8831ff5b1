"""Valid and invalid values for a ValueInfo."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from eal_actors.device.data import DataType, EALData
from eal_actors.device.info import CommandInfo, ValueInfo

_NUMBERS: Final = (DataType.INT, DataType.FLOAT, DataType.DOUBLE)


def bad_values(info: ValueInfo) -> Iterator[Any]:
    """Yield values of a wrong type, and values just outside of the range."""
    yield "a text" if info.type is not DataType.CHAR else 4.5
    if info.type is not DataType.BOOL:
        yield True
    if info.type is DataType.INT:
        yield 0.5
    if info.type in _NUMBERS and not info.shape:
        if info.minimum is not None:
            yield _of_type(info, info.minimum - 1)
        if info.maximum is not None:
            yield _of_type(info, info.maximum + 1)


def _of_type(info: ValueInfo, number: float) -> float | int:
    return int(number) if info.type is DataType.INT else float(number)


def bad_commands(info: CommandInfo) -> Iterator[tuple[str, Any]]:
    """Yield text and data of calls whose argument is missing, unexpected or wrong, of a command or request."""
    if info.argument is None:
        yield info.name, 1
        return
    prefix = info.prefix
    if prefix is None:
        yield info.name, None
        for value in bad_values(info.argument):
            yield info.name, value
        return
    yield f"{prefix}not-a-value!", 1
    for value in bad_values(info.argument):
        if isinstance(value, int | float) and not isinstance(value, bool):
            yield f"{prefix}{value}", None


def lasting_argument(info: CommandInfo) -> tuple[str, Any] | None:
    """Return text and data that make a command last as long as possible; None if no argument can be chosen."""
    argument = info.argument
    if argument is None:
        return info.name, None
    if argument.shape or (argument.type not in _NUMBERS and not argument.choices):
        return None
    if argument.choices:
        value: Any = argument.choices[-1]
    elif argument.maximum is not None:
        value = _of_type(argument, argument.maximum)
    else:
        value = _of_type(argument, max(100.0, argument.minimum or 0.0))
    return (info.name, value) if info.prefix is None else (f"{info.prefix}{value}", None)


def other_value(info: ValueInfo, present: EALData) -> Any:
    """Return a valid value that differs from the present one; None if none is found."""
    if info.shape:
        return None
    candidates: list[Any] = list(info.choices)
    if info.type is DataType.BOOL:
        candidates = [True, False]
    elif info.type in _NUMBERS and not candidates:
        limits = [limit for limit in (info.minimum, info.maximum) if limit is not None]
        candidates = [_of_type(info, number) for number in (*limits, 1, 2)]
    for value in candidates:
        data = EALData.of(value)
        if data.value != present.value and info.problem(data) is None:
            return value
    return None
