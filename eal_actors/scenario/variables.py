"""`${name}` in the values of a scenario; `$${` is a literal `${`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Final

from eal_actors.data import EALData
from eal_actors.errors import ScenarioError
from eal_actors.strict_model import did_you_mean

_REFERENCE: Final = re.compile(r"\$(?P<escape>\$\{)|\$\{(?:(?P<name>[A-Za-z_][A-Za-z0-9_]*)\})?")


def names_in(value: object) -> list[str]:
    """Return the variables that a value refers to, each once, in their order.

    Raises:
        ScenarioError: a `${` that does not go on as `${name}`.
    """
    if isinstance(value, tuple):
        return list(dict.fromkeys(name for item in value for name in names_in(item)))
    if not isinstance(value, str):
        return []
    names: dict[str, None] = {}
    for match in _REFERENCE.finditer(value):
        if match["name"]:
            names[match["name"]] = None
        elif not match["escape"]:
            raise ScenarioError("${ must go on as ${name}; write $${ for a literal ${")
    return list(names)


def substitute(value: object, variables: Mapping[str, object]) -> object:
    """Return a value with variables put in; a text that is one `${name}` and nothing else becomes what it stands for.

    Raises:
        ScenarioError: a variable has no value, or one that cannot stand inside a text.
    """
    if isinstance(value, tuple):
        return tuple(substitute(item, variables) for item in value)
    if not isinstance(value, str) or "${" not in value:
        return value
    whole = _REFERENCE.fullmatch(value)
    if whole is not None and whole["name"]:
        return _look_up(whole["name"], variables)
    return substitute_text(value, variables)


def unknown_variable(name: str, known: Iterable[str]) -> str:
    """Return the message for a variable that nothing brings into scope."""
    names = set(known)
    hint = did_you_mean(name, names) if names else "; no variable is known here"
    return f"unknown variable '{name}'{hint}"


def substitute_text(text: str, variables: Mapping[str, object]) -> str:
    """Return a text with variables put in: the result is text even where it is one `${name}` and nothing else.

    Raises:
        ScenarioError: see substitute.
    """

    def insert(match: re.Match[str]) -> str:
        name = match["name"]
        return match["escape"] or _as_text(name, _look_up(name, variables))

    return _REFERENCE.sub(insert, text) if "${" in text else text


def _look_up(name: str, variables: Mapping[str, object]) -> object:
    try:
        return variables[name]
    except KeyError:
        raise ScenarioError(f"the variable '{name}' has no value: the step that saves it did not succeed") from None


def _as_text(name: str, value: object) -> str:
    plain = value.value if isinstance(value, EALData) else value
    if isinstance(plain, bool):
        return "true" if plain else "false"
    if isinstance(plain, str | int | float):
        return str(plain)
    raise ScenarioError(f"the variable '{name}' is of type {type(plain).__name__}, which cannot stand in a text")
