"""Options that several commands share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

from eal_actors.facade.connections import FLEET_VARIABLE
from eal_actors.kernel.log import LogFormat

LogLevel = Literal["debug", "info", "warning", "error"]

FleetOption = Annotated[
    Path,
    typer.Option(
        "--fleet", "-f", envvar=FLEET_VARIABLE, show_default=False, help="The fleet file, or a shipped one by name."
    ),
]
RobotsArgument = Annotated[
    list[str] | None,
    typer.Argument(metavar="[ROBOT]...", show_default=False, help="Names of robots; all if none is given."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON for programs.")]


@dataclass(frozen=True, slots=True)
class GlobalOptions:
    """What stands before the command's name.

    Attributes:
        log_format: how log lines look.
        log_level: the least level shown.
    """

    log_format: LogFormat = "human"
    log_level: LogLevel = "warning"
