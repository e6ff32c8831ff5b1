"""Values of variables as records keep them: plain JSON, and what is more than that by a mapping with one key."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from eal_actors.device.data import EALData
from eal_actors.kernel.errors import DataError
from eal_actors.scenario.strict_json import plain_json

MAX_ELEMENTS: Final = 10_000
MAX_BITS: Final = 1024
"""Longer whole numbers are not kept: readers of JSON refuse them."""
_DATA: Final = "eal_data"
_FLOAT: Final = "eal_float"
"""Numbers that JSON has no form for."""
_TAGS: Final = ({_DATA}, {_FLOAT})


def to_record(value: object) -> Any:
    """Return a value for a record; None for what does not go into one, see `is_recordable`."""
    if isinstance(value, EALData):
        inner = _plain(value.value)
        return {_DATA: inner} if inner is not None else None
    return _plain(value)


def is_recordable(value: object) -> bool:
    """Return whether a value can be kept in a record and comes back from it as it was."""
    return value is None or to_record(value) is not None


def told(value: object) -> Any:
    """Return a value as those who only look at a run want it: plain JSON; None for what does not go into a record."""
    return plain_json(value) if is_recordable(value) else None


def from_record(value: Any) -> Any:
    """Return the value that `to_record` made this of.

    Raises:
        DataError: it made this of nothing.
    """
    if isinstance(value, dict):
        if set(value) == {_DATA}:
            return EALData.of(from_record(value[_DATA]))
        return float(value[_FLOAT]) if set(value) == {_FLOAT} else {key: from_record(value[key]) for key in value}
    if isinstance(value, list):
        return [from_record(item) for item in value]
    if isinstance(value, str | int | float | None):
        return value
    raise DataError(f"{value!r} is no value of a record")


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return _plain(value.tolist()) if getattr(value, "size", 1) <= MAX_ELEMENTS else None
    if isinstance(value, float):
        return value if math.isfinite(value) else {_FLOAT: plain_json(value)}
    if isinstance(value, str):
        return value
    if isinstance(value, int):
        return value if value.bit_length() <= MAX_BITS else None
    if isinstance(value, tuple | list):
        items = [_plain(item) for item in value[: MAX_ELEMENTS + 1]]
        return None if len(items) > MAX_ELEMENTS or any(item is None for item in items) else items
    if isinstance(value, Mapping):
        entries = {key: _plain(item) for key, item in value.items() if isinstance(key, str)}
        is_whole = len(entries) == len(value) <= MAX_ELEMENTS and set(entries) not in _TAGS
        return entries if is_whole and all(value[key] is None or entries[key] is not None for key in entries) else None
    return None
