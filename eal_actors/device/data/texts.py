"""Texts about values, for messages and lists."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any, Final

from eal_actors.device.data.c_types import SHOWN_BYTES, SHOWN_ELEMENTS, TEXT, DataType, short_repr
from eal_actors.device.data.storage import unpack
from eal_actors.kernel.errors import ArgumentError

if TYPE_CHECKING:
    from eal_actors.device.data.value import EALData

SHOWN_NUMBERS: Final = 16
"""Arrays with at most so many numbers are shown as numbers, such as a pose; others by their shape."""


def data_text(data: EALData) -> str:
    """Return a value with its type, length and notes, such as `EALData(double 0.5, unit='m')`."""
    c_type = data.c_type
    size = f"[{data.length // c_type.width}]" if c_type.is_ptr else ""
    meta = {"unit": data.unit, "frame_id": data.frame_id, "stamp_s": data.stamp_s}
    notes = "".join(f", {name}={short_repr(note)}" for name, note in meta.items() if note is not None)
    return f"EALData({c_type.name}{size} {_content_text(data)}{notes})"


def _content_text(data: EALData) -> str:
    """Return the content of a value, short even for a large one."""
    c_type = data.c_type
    if data.shape is not None:
        is_short = math.prod(data.shape) <= SHOWN_NUMBERS
        return _rounded(data.value.tolist()) if is_short else f"shape={data.shape}"
    if not c_type.is_ptr or c_type == TEXT:
        return short_repr(data.value)
    if c_type.type is DataType.VOID:
        return short_repr(bytes(data.payload[: SHOWN_BYTES + 1]))
    return short_repr(unpack(c_type, data.payload[: (SHOWN_ELEMENTS + 1) * c_type.width]))


def _rounded(value: Any) -> str:
    """Return a list of numbers as text, with six digits."""
    if isinstance(value, list):
        return f"[{', '.join(map(_rounded, value))}]"
    return f"{value:.6g}" if isinstance(value, float) else repr(value)


def json_object(text: str, wanted: str) -> dict[str, Any]:
    """Return the fields of a JSON object.

    Raises:
        ArgumentError: the text is none; the message begins with `wanted`.
    """
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ArgumentError(f"{wanted}: {error}") from None
    if not isinstance(found, dict):
        raise ArgumentError(f"{wanted}, not {text[:40]!r}")
    return found


def range_text(minimum: float | None, maximum: float | None) -> str:
    """Return a range as text, such as `0..360` or `0..`; empty without limits."""
    text = "..".join("" if limit is None else f"{limit:g}" for limit in (minimum, maximum))
    return "" if text == ".." else text


def repr_of(data: EALData) -> str:
    """Return a value as its user wrote it, if that is short."""
    value = data.value if data.shape is None else data
    return repr(value if isinstance(value, int | float | str | None) else data)
