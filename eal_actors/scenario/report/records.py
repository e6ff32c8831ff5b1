"""Values in records: strict JSON, and the forms of values that JSON lacks.

Strict JSON has no form for NaN and infinities; they are texts, as in the JSON form of protocol buffers. A record must
give a variable back as it was, so a value without a JSON form is a mapping with one reserved key.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, Final

from eal_actors.device.data import EALData
from eal_actors.kernel.errors import DataError

MAX_ELEMENTS: Final = 10_000
MAX_BITS: Final = 1024
"""Longer whole numbers are not kept, because readers of JSON refuse them."""
_DATA: Final = "eal_data"
_FLOAT: Final = "eal_float"
"""Numbers without a form in JSON."""
_TAGS: Final = ({_DATA}, {_FLOAT})
_TEXTS: Final = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}


def to_record(value: object) -> Any:
    """Return a value for a record, or None if it has no form in one; see `is_recordable`."""
    if isinstance(value, EALData):
        inner = _to_json(value.value)
        return {_DATA: inner} if inner is not None else None
    return _to_json(value)


def is_recordable(value: object) -> bool:
    """Return whether a value can be written to a record and read back unchanged."""
    return value is None or to_record(value) is not None


def to_view(value: object) -> Any:
    """Return a value as plain JSON for viewers, or None if it has no form in a record."""
    return plain_json(value) if is_recordable(value) else None


def from_record(value: Any) -> Any:
    """Return the value of the result of `to_record`; raise DataError if it is no such result."""
    if isinstance(value, dict):
        if set(value) == {_DATA}:
            return EALData.of(from_record(value[_DATA]))
        return float(value[_FLOAT]) if set(value) == {_FLOAT} else {key: from_record(value[key]) for key in value}
    if isinstance(value, list):
        return [from_record(item) for item in value]
    if isinstance(value, str | int | float | None):
        return value
    raise DataError(f"{value!r} is no value of a record")


def _to_json(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return _to_json(value.tolist()) if getattr(value, "size", 1) <= MAX_ELEMENTS else None
    if isinstance(value, float):
        return value if math.isfinite(value) else {_FLOAT: plain_json(value)}
    if isinstance(value, int):
        return value if value.bit_length() <= MAX_BITS else None
    if isinstance(value, tuple | list):
        items = [_to_json(item) for item in value[: MAX_ELEMENTS + 1]]
        return None if len(items) > MAX_ELEMENTS or any(item is None for item in items) else items
    if isinstance(value, Mapping):
        return _mapping_to_json(value)
    return value if isinstance(value, str) else None


def _mapping_to_json(value: Mapping[Any, Any]) -> dict[str, Any] | None:
    entries = {key: _to_json(item) for key, item in value.items() if isinstance(key, str)}
    is_whole = len(entries) == len(value) <= MAX_ELEMENTS and set(entries) not in _TAGS
    return entries if is_whole and all(value[key] is None or entries[key] is not None for key in entries) else None


def whole_text(text: str) -> str:
    """Return a text with escapes in place of surrogates, halves of characters, which no file can hold."""
    return text.encode(errors="backslashreplace").decode()


# Strict JSON.


def plain_json(value: Any) -> Any:
    """Return a value for strict JSON: "NaN", "Infinity" and "-Infinity" as texts, and the value of EALData."""
    if isinstance(value, float):
        return value if math.isfinite(value) else json.dumps(value)
    if isinstance(value, Mapping):
        return {key: plain_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_json(item) for item in value]
    if isinstance(value, EALData):
        return plain_json(value.value)
    return plain_json(value.tolist()) if hasattr(value, "tolist") else value


def as_json(
    value: Any, *, indent: int | None = None, separators: tuple[str, str] | None = None, ensure_ascii: bool = True
) -> str:
    """Return a value as strict JSON, with options of `json.dumps`; raise TypeError if it has no form, like bytes."""
    return json.dumps(
        plain_json(value), indent=indent, separators=separators, ensure_ascii=ensure_ascii, allow_nan=False
    )


def numbers_again(value: Any) -> Any:
    """Return a number, or lists of numbers, with the texts of `plain_json` as numbers again."""
    if isinstance(value, list):
        return [numbers_again(item) for item in value]
    return _TEXTS.get(value, value) if isinstance(value, str) else value
