"""Errors of YAML's syntax in plain words, at the line that must be changed.

PyYAML reports where its scanner gave up, in the terms of its grammar. The usual mistakes are recognised here; what is
left keeps PyYAML's words.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final

import yaml

_KEY: Final = re.compile(r"\s*(- +)*[^\s#'\"\[{][^#]*?:(\s|$)")
"""A line that begins with a key."""
_STREAM_END: Final = "found unexpected end of stream"
_CLOSING: Final = {"]": "list", "}": "mapping"}


def explain(error: yaml.MarkedYAMLError, text: str) -> tuple[str, int, int]:
    """Return what is wrong, and the line and the column of it, both from 1; 0 if the place is unknown."""
    context = error.context or ""
    lines, problem = text.splitlines(), error.problem or context
    here, began = _place(error.problem_mark or error.context_mark), _place(error.context_mark or error.problem_mark)
    if problem == _STREAM_END and "quoted scalar" in context:
        return "the quote that begins here is not closed", *began
    if (opened := re.match(r"expected ',' or '([]}])'", problem)) is not None:
        return _open_bracket(lines, opened[1], began, here)
    if problem == "could not find expected ':'":
        return _missing_colon(lines, began[0])
    for pattern, explained in _MISTAKES:
        if (found := re.search(pattern, problem)) is not None:
            return explained(lines, *here) if callable(explained) else (found.expand(explained), *here)
    parsing = f", {context} from line {began[0]}" if context and context != problem else ""
    return f"not valid YAML: {problem}{parsing}{_about_reference(lines, here[0])}", *here


def _place(mark: yaml.Mark | None) -> tuple[int, int]:
    return (mark.line + 1, mark.column + 1) if mark is not None else (0, 0)


def _line(lines: list[str], number: int) -> str:
    return lines[number - 1] if 0 < number <= len(lines) else ""


def _content(line: str) -> str:
    """Return a line without its indentation, the dashes before it and a comment after it."""
    return re.sub(r"\s#.*", "", re.sub(r"^\s*(- +)*", "", line)).strip()


def _missing_colon(lines: list[str], number: int) -> tuple[str, int, int]:
    line = _line(lines, number)
    word = (_content(line).split() or [""])[0]
    if ":" in word:
        return f"a space is missing after the ':' in '{word}'", number, line.index(word) + word.index(":") + 2
    return f"a ':' is missing after '{word}'", number, line.index(word) + len(word) + 1 if word else 1


def _key_in_a_value(lines: list[str], number: int, column: int) -> tuple[str, int, int]:
    line = _line(lines, number)
    if _KEY.match(line[: column - 1]):
        return "a second ': ' in one line: put the value in quotes, or begin a new line", number, column
    above = number - 1
    while above and not _content(_line(lines, above)):
        above -= 1
    former = _line(lines, above)
    if above and not _KEY.match(former):
        return _missing_colon(lines, above)
    key = _content(former).partition(":")[0]
    indent = len(former) - len(former.lstrip())
    message = f"the line is indented below '{key}', which has a value already: begin it in column {indent + 1}"
    return message, number, len(line) - len(line.lstrip()) + 1


def _indentation(lines: list[str], number: int, column: int) -> tuple[str, int, int]:
    """Explain a line whose indentation is that of no line above."""
    line = _line(lines, number)
    indent = len(line) - len(line.lstrip())
    if column > indent + 1:
        return (
            "something follows a value that is complete: put all of it in quotes, or begin a new line",
            number,
            column,
        )
    fitting: list[int] = []
    for above in reversed(lines[: number - 1]):
        own = len(above) - len(above.lstrip())
        if _content(above) and (not fitting or own < fitting[-1]):
            fitting.append(own)
    near = sorted((own for own in fitting if own != indent), key=lambda own: abs(own - indent))[:2]
    if indent in fitting:  # a list among keys, or the reverse
        what = "a list item stands among keys" if line.lstrip().startswith("-") else "a key stands among list items"
        return f"{what}: all lines of a block begin alike", number, column
    columns = " or ".join(str(own + 1) for own in sorted(near))
    return f"the indentation fits no line above: begin the line in column {columns or 1}", number, column


def _open_bracket(
    lines: list[str], closing: str, began: tuple[int, int], here: tuple[int, int]
) -> tuple[str, int, int]:
    what = f"the {_CLOSING[closing]} that begins in line {began[0]}"
    if here[0] > len(lines) or not _line(lines, here[0])[here[1] - 1 :].strip():
        return f"a '{closing}' is missing at the end of {what}", *here
    return f"a ',' or '{closing}' is missing in {what}{_about_reference(lines, here[0])}", *here


def _about_reference(lines: list[str], number: int) -> str:
    if "${" not in _line(lines, number):
        return ""
    return "; inside [...] and {...} a ${NAME} must stand in quotes, or write the value on a line of its own"


_Explain = Callable[[list[str], int, int], tuple[str, int, int]]
_MISTAKES: Final[tuple[tuple[str, str | _Explain], ...]] = (
    (r"^but found another document", "a second document starts here; one file holds one document"),
    (r"'\\t'", "YAML does not allow a tab here; use spaces"),
    (r"^mapping values are not allowed here", _key_in_a_value),
    (r"^expected <block end>", _indentation),
    (r"^found character '(.)' that cannot start any token", r"a value cannot begin with \1: put it in quotes"),
)
"""Patterns of PyYAML's words, and the words instead, or the function that finds them."""
