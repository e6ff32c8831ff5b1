"""JSON that every reader takes: numbers that it has no form for are texts, as in the JSON form of protocol buffers."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, Final

from eal_actors.device.data import EALData

_TEXTS: Final = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}


def plain_json(value: Any) -> Any:
    """Return a value with "NaN", "Infinity" and "-Infinity" for what JSON has no number for; of EALData the value."""
    if isinstance(value, float):
        return value if math.isfinite(value) else _text(value)
    if isinstance(value, Mapping):
        return {key: plain_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_json(item) for item in value]
    if isinstance(value, EALData):
        return plain_json(value.value)
    return plain_json(value.tolist()) if hasattr(value, "tolist") else value


def _text(value: float) -> str:
    return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"


def as_json(
    value: Any, *, indent: int | None = None, separators: tuple[str, str] | None = None, ensure_ascii: bool = True
) -> str:
    """Return a value as strict JSON; the rest is as with `json.dumps`.

    Raises:
        TypeError: JSON has no form for it, as for bytes.
    """
    return json.dumps(
        plain_json(value), indent=indent, separators=separators, ensure_ascii=ensure_ascii, allow_nan=False
    )


def numbers_again(value: Any) -> Any:
    """Return what must be a number, or lists of them, with the numbers that `plain_json` made texts of."""
    if isinstance(value, list):
        return [numbers_again(item) for item in value]
    return _TEXTS.get(value, value) if isinstance(value, str) else value
