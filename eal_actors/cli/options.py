"""Options that several commands share, and the command classes that show them in `--help`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeAlias

import typer
from typer.core import TyperCommand, TyperGroup

from eal_actors.cli.completion import complete_fleets, complete_robots, complete_scenarios
from eal_actors.cli.output import json_alone
from eal_actors.kernel.bundled import FLEET_VARIABLE
from eal_actors.kernel.errors import ConfigError, ScenarioError
from eal_actors.kernel.log import LogFormat

LogLevel = Literal["debug", "info", "warning", "error"]


_FLEET: Any = typer.Option(
    "--fleet",
    "-f",
    envvar=FLEET_VARIABLE,
    help="Fleet file, or the name of a bundled one.",
    autocompletion=complete_fleets,
)
_SCENARIO: Any = typer.Argument(
    metavar="SCENARIO", help="Scenario file, or the name of a bundled one.", autocompletion=complete_scenarios
)
FleetOption: TypeAlias = Annotated[Path, _FLEET]
ScenarioArgument: TypeAlias = Annotated[Path, _SCENARIO]
# `eal run --resume` takes both files from the run.
OptionalFleetOption: TypeAlias = Annotated[Path | None, _FLEET]
OptionalScenarioArgument: TypeAlias = Annotated[Path | None, _SCENARIO]
RobotsArgument = Annotated[
    list[str] | None,
    typer.Argument(metavar="[ROBOT]...", help="Names of robots; default: all robots.", autocompletion=complete_robots),
]


def _keep_stdout(context: typer.Context, as_json: bool) -> bool:
    if as_json:
        context.with_resource(json_alone())
    return as_json


JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON for programs.", callback=_keep_stdout)]
JobsOption: TypeAlias = Annotated[
    int | None,
    typer.Option("--jobs", "-j", min=1, max=256, show_default="one for each processor", help="Processes."),
]
SettingsOption: TypeAlias = Annotated[
    list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Value of a parameter; repeatable.")
]
BindingsOption: TypeAlias = Annotated[
    list[str] | None,
    typer.Option("--bind", metavar="ROLE=ROBOT,...", help="Robots of a role, instead of the scenario's; repeatable."),
]
KeepOption: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--keep",
        metavar="PLUGIN",
        help="Use this plugin itself, not a simulated one: it must not move anything real; repeatable.",
    ),
]


@dataclass(frozen=True, slots=True)
class GlobalOptions:
    """The options before the command's name: the format of log lines, and the lowest level shown."""

    log_format: LogFormat = "human"
    log_level: LogLevel = "warning"

    @classmethod
    def of(cls, context: Any) -> Self:
        """Return the options of a command's context; the defaults where the error is in the options themselves."""
        return context.find_object(cls) or cls()


class _PlainFlags:
    """Shows flags without a type in the help, because a flag takes no value."""

    def get_params(self, ctx: Any) -> Any:
        params = super().get_params(ctx)  # type: ignore[misc]  # of the command with which this is mixed
        for param in params:
            if getattr(param, "is_flag", False):
                param.metavar = ""
        return params


class EalCommand(_PlainFlags, TyperCommand):
    """A command of `eal`."""


class EalCommandGroup(_PlainFlags, TyperGroup):
    """A group of commands of `eal`."""


@contextmanager
def bad_option(option: str) -> Iterator[None]:
    """Turn a ValueError or a ScenarioError of the block into that of an option, unless it is about a file.

    Raises BadParameter if the option's value is wrong.
    """
    try:
        yield
    except ConfigError:
        raise
    except (ValueError, ScenarioError) as error:
        raise typer.BadParameter(str(error), param_hint=f"'{option}'") from error
