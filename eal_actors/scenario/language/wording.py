"""Values as texts for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from eal_actors.device.data import EALData
from eal_actors.kernel.errors import EALError
from eal_actors.scenario.language.expressions.evaluation import Namespace, expressions_in, render
from eal_actors.scenario.language.expressions.functions import as_text
from eal_actors.scenario.language.expressions.grammar import Expression, parse_template

_MOST_VALUES: Final = 8
_MOST_CHARACTERS: Final = 60


def show_value(value: object, parameters: Mapping[str, object]) -> str:
    """Return a value with the values of parameters inserted, if it needs nothing else; otherwise as written."""
    if isinstance(value, tuple | list):
        items = [show_value(item, parameters) for item in value[:_MOST_VALUES]]
        return f"[{', '.join(items)}{', ...' if len(value) > _MOST_VALUES else ''}]"
    if not isinstance(value, str) or "${" not in value:
        return short_number(value)
    needed = {name.name for expression, _ in parse_template(value).expressions() for name in expression.names}
    if not needed <= set(parameters) or any(expression.readings for expression in expressions_in(value)):
        return value
    try:
        return show_value(render(value, Namespace(parameters)), {})
    except EALError:
        return value


def short_number(value: object) -> str:
    """Return a value as a text, a float without trailing zeros."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def short_value(value: object) -> str:
    """Return a value of the run as a short text."""
    inner = value.value if isinstance(value, EALData) else value
    if isinstance(inner, float):
        return f"{inner:.6g}"
    if isinstance(inner, bool):
        return as_text(inner)
    try:
        text = repr(inner.tolist() if hasattr(inner, "tolist") and getattr(inner, "size", 99) <= 8 else inner)
    except Exception:  # noqa: BLE001  # an object of a Python step may raise any exception
        text = f"of type {type(inner).__name__}"
    return text if len(text) <= _MOST_CHARACTERS else f"{text[: _MOST_CHARACTERS - 3]}..."


def describe_names(expression: Expression, names: Namespace) -> str:
    """Return the values of the readings and variables of an expression, as the end of a message."""
    parts = [f"{reading} is {short_value(names.readings[reading])}" for reading, _ in expression.readings]
    parts += [
        f"{name.name} is {short_value(names.variables[name.name])}"
        for name in expression.names
        if name.name in names.variables and name.name != "run"
    ]
    return f", but {', '.join(parts)}" if parts else ""


def until_words(until: str) -> str:
    """Return the `until` of a block for people; empty for `all`."""
    return {"all": "", "first": ", until the first is through"}.get(until, f", until signal {until}")
