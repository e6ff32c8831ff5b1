"""The registry of step kinds: it imports the modules of this package and builds the union of their models."""

from __future__ import annotations

import pkgutil
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from typing import Annotated, Any, Union

from pydantic import BeforeValidator, Discriminator, Tag

from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.scenario import steps
from eal_actors.scenario.language.scenario import Step


def register(kind: type[Step]) -> None:
    """Add a kind of another package before the first scenario is read; raise ValueError if its name is taken."""
    if kinds().setdefault(kind.kind, kind) is not kind:
        raise ValueError(f"there is a step kind '{kind.kind}' already")


@cache
def kinds() -> dict[str, type[Step]]:
    """Return all kinds by their keys."""
    found: dict[str, type[Step]] = {}
    for info in sorted(pkgutil.iter_modules(steps.__path__), key=lambda info: info.name):
        module = import_module(f"{steps.__name__}.{info.name}")
        for value in vars(module).values():
            if isinstance(value, type) and issubclass(value, Step) and "kind" in vars(value):
                found[value.kind] = value
    return found


def step_union() -> Any:
    """Return the union of all kinds, as an annotation for pydantic."""
    choices = tuple(Annotated[kind, Tag(kind.__name__)] for kind in kinds().values())
    return Annotated[Union[choices], Discriminator(_tag), BeforeValidator(_check_kind)]  # noqa: UP007  # known at run time


def _tag(value: object) -> str:
    if isinstance(value, Mapping):
        found = kinds()
        return next(found[key].__name__ for key in value if key in found)
    return type(value).__name__ if isinstance(value, Step) else "LogStep"  # which refuses it: it is not a mapping


def _check_kind(value: object) -> object:
    """Refuse a mapping that is no step, or two at once, with a hint."""
    if isinstance(value, Mapping):
        known = kinds()
        found = [key for key in value if key in known]
        if len(found) > 1:
            raise ValueError(
                f"is {' and '.join(repr(kind) for kind in found)} at once; begin each step with its own '-'"
            )
        if not found:
            keys = [key for key in value if key not in _modifiers()]
            hint = did_you_mean(str(keys[0]), known) if keys else ""
            unknown = f"unknown step '{keys[0]}'{hint}" if keys else "is no step"
            raise ValueError(unknown if hint else f"{unknown}; a step is one of {', '.join(known)}")
    return value


def _modifiers() -> set[str]:
    """Return the keys of steps that do not name a kind."""
    fields = {field.alias or name for kind in kinds().values() for name, field in kind.model_fields.items()}
    return fields - set(kinds())
