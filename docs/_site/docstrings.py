"""Docstrings are written for people who read the source: plain text, `code` in single backticks, indented examples."""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

_CODE = re.compile(r"(?<![`:])`([^`\n]+)`(?![`_])")
_SECTION = re.compile(r"^[A-Z][A-Za-z ]*:$")
_FIELD_NAME = re.compile(r"^(\s{4,})(\*{1,2}\w+)(:)")


def as_rest(lines: list[str]) -> list[str]:
    """Return a docstring's lines as reStructuredText, which napoleon then reads."""
    made: list[str] = []
    is_before_sections, was_blank, is_code = True, True, False
    for line in lines:
        is_before_sections = is_before_sections and not _SECTION.match(line)
        is_indented = line.startswith("    ") and is_before_sections
        if is_indented and was_blank and not is_code:
            made += [".. code-block:: python", ""]
            is_code = True
        elif line and not is_indented:
            is_code = False
        made.append(line if is_code else _inline(line))
        was_blank = not line.strip()
    return made


def _inline(line: str) -> str:
    """Return a line with its code marked, and with the characters escaped that mean something else there."""
    parts = _CODE.split(line)
    parts[0::2] = [re.sub(r"(?<![\w\\*])\*(?=\S)|(?<=\w)_(?!\w)", r"\\\g<0>", part) for part in parts[0::2]]
    parts[1::2] = [f"``{part}``" for part in parts[1::2]]
    return "".join(parts)


def _process(_app: Sphinx, _what: str, _name: str, _object: Any, _options: Any, lines: list[str]) -> None:
    lines[:] = as_rest(lines)


def setup(app: Sphinx) -> dict[str, bool]:
    """Go before napoleon."""
    app.connect("autodoc-process-docstring", _process, priority=400)
    return {"parallel_read_safe": True}
