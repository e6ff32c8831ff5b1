"""Texts for values: JSON objects, and ranges in messages and lists."""

from __future__ import annotations

import json
import math
from typing import Any

from eal_actors.kernel.errors import ArgumentError


def json_object(text: str, wanted: str) -> dict[str, Any]:
    """Return the fields of a JSON object; ArgumentError if the text is none; the message begins with `wanted`."""
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ArgumentError(f"{wanted}: {error}") from None
    if not isinstance(found, dict):
        raise ArgumentError(f"{wanted}, not {text[:40]!r}")
    return found


def finite_json(text: str | bytes) -> Any:
    """Return the value of standard JSON, whose numbers are finite.

    Raises ValueError if the text is none, or is nested too deeply.
    """
    try:
        return json.loads(text, parse_constant=_refuse, parse_float=_finite)
    except RecursionError as error:
        raise ValueError(str(error)) from None


def _refuse(name: str) -> None:
    raise ValueError(f"{name} is no number of JSON")


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text[:40]} is too large for a number")
    return number


def range_text(minimum: float | None, maximum: float | None) -> str:
    """Return a range as text, such as `0..360` or `0..`; empty without limits."""
    text = "..".join("" if limit is None else f"{limit:g}" for limit in (minimum, maximum))
    return "" if text == ".." else text
