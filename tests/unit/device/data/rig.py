"""The short names of the types, and how data are taken apart and rebuilt."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st

from eal_actors.device.data import DataType, EALData

INT, CHAR, FLOAT, DOUBLE, BOOL, VOID = DataType
PTR, UNSIGNED, SHORT, LONG = ({"is_ptr": True}, {"is_unsigned": True}, {"is_short": True}, {"is_long": True})
MODIFIERS = ("is_ptr", "is_unsigned", "is_short", "is_long")

TEXTS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"))


def modifiers_of(data: EALData) -> dict[str, Any]:
    return {name: True for name in MODIFIERS if getattr(data, name)}


def rebuilt(data: EALData, payload: Any = None) -> EALData:
    """Take data apart and rebuild it, as the network does."""
    return EALData.from_payload(
        data.type,
        bytes(data.payload) if payload is None else payload,
        **modifiers_of(data),
        shape=data.shape,
        dtype=data.dtype,
        unit=data.unit,
        frame_id=data.frame_id,
        stamp_s=data.stamp_s,
    )
