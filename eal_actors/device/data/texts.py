"""Texts about values, for messages and lists."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from eal_actors.device.data.value import EALData


def range_text(minimum: float | None, maximum: float | None) -> str:
    """Return a range as text, such as `0..360` or `0..`; empty without limits."""
    text = "..".join("" if limit is None else f"{limit:g}" for limit in (minimum, maximum))
    return "" if text == ".." else text


def repr_of(data: EALData) -> str:
    """Return a value as its user wrote it, if that is short."""
    value = data.value if data.shape is None else data
    return repr(value if isinstance(value, int | float | str | None) else data)
