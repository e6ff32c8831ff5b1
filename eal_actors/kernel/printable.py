"""Texts of others for a terminal: without characters that move its cursor, change its title, or reverse the text."""

from __future__ import annotations

import re
from typing import Final

_HIDDEN: Final = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")
"""Control characters but tab and newline, and the marks that change the direction of a text."""


def printable(text: str) -> str:
    r"""Return a text with its control characters written out, such as `\x1b`."""
    return _HIDDEN.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def printable_json(text: str) -> str:
    r"""Return JSON of the same content whose strings have their control characters written out, such as `\u009b`."""
    return _HIDDEN.sub(lambda found: f"\\u{ord(found[0]):04x}", text)
