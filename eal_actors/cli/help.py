"""How `--help` shows options."""

from __future__ import annotations

from typing import Any

from typer.core import TyperCommand, TyperGroup


class Command(TyperCommand):
    """A command whose flags stand in its help without a type: they take no value."""

    def get_params(self, ctx: Any) -> Any:
        """Return the command's parameters."""
        return _without_flag_types(super().get_params(ctx))


class Group(TyperGroup):
    """A group of commands, whose own flags stand in its help without a type."""

    def get_params(self, ctx: Any) -> Any:
        """Return the group's own parameters."""
        return _without_flag_types(super().get_params(ctx))


def _without_flag_types(params: list[Any]) -> list[Any]:
    for param in params:
        if getattr(param, "is_flag", False):
            param.metavar = ""
    return params
