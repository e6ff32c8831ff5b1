"""Suggestions for names that nobody knows."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from typing import Final

_MOST_LISTED: Final = 12
_DIGITS: Final = re.compile(r"\d+")


def nearest(word: str, choices: Iterable[str]) -> str | None:
    """Return the choice that somebody who wrote a word probably meant: swapped, missing and wrong letters."""
    names = sorted(set(choices))
    if swapped := [name for name in names if name != word and sorted(name) == sorted(word)]:
        return swapped[0]
    return next(iter(difflib.get_close_matches(word, names, n=1)), None)


def did_you_mean(word: str, choices: Iterable[str]) -> str:
    """Return `; did you mean 'x'?` for the choice nearest to a word, else the choices if they are few, else nothing."""
    names = sorted(set(choices))
    if (near := nearest(word, names)) is not None:
        return f"; did you mean '{near}'?"
    return f"; known: {', '.join(names)}" if 0 < len(names) <= _MOST_LISTED else ""


def numbered_name_meant(word: str, choices: Iterable[str]) -> str:
    """Return `; did you mean 'x'?` for the nearest name; one that differs in its number only is another robot."""
    near = nearest(word, [name for name in choices if _DIGITS.sub("", name) != _DIGITS.sub("", word)])
    return "" if near is None else f"; did you mean '{near}'?"
