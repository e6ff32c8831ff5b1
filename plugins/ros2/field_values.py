"""The values of message fields: from plain Python values, and back."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

DTYPES: Final = {
    **{name: name for name in ("int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64")},
    "float32": "float32",
    "float64": "float64",
    "bool": "bool",
    "byte": "uint8",
    "char": "uint8",
}
"""The numpy type of each basic type."""


def numbers(items: Any, dtype: str) -> Any:
    """Return numbers as an array; bytes are its octets.

    Raises:
        ValueError: a number does not fit.
    """
    if isinstance(items, bytes | bytearray | memoryview):
        return np.frombuffer(items, dtype)
    if isinstance(items, list) and items and items[0] is None:
        return np.zeros(len(items), dtype)
    found = np.asarray(items)
    if found.size and dtype.startswith(("int", "uint")):
        limits = np.iinfo(dtype)
        if found.dtype.kind not in "iub" or found.min() < limits.min or found.max() > limits.max:
            raise ValueError(f"not all are of {dtype}")
    return found.astype(dtype)


def scalar(base: str, given: Any) -> Any:
    """Return a value of a basic type; None is zero or empty.

    Raises:
        ValueError: it does not fit.
    """
    if base == "string":
        if not isinstance(given, str | None):
            raise ValueError(f"{given!r} is no text")
        return given or ""
    if base == "bool":
        return bool(given)
    if base.startswith("float"):
        return float(given or 0.0)
    if given is not None and (isinstance(given, bool) or int(given) != given):
        raise ValueError(f"{given!r} is no {base}")
    return int(given or 0)


def plain(value: Any) -> Any:
    """Return plain lists, dictionaries, texts and numbers; NaN and infinity, which JSON lacks, become None."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list):
        return [plain(item) for item in value]
    if hasattr(value, "__msgtype__"):
        return {name: plain(item) for name, item in vars(value).items() if not name.startswith("__")}
    return value
