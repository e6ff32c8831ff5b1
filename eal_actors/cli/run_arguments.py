"""The arguments and options of `eal run`, as Typer reads them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from eal_actors.facade.connections import FLEET_VARIABLE
from eal_actors.recording import Extent

ScenarioArgument: TypeAlias = Annotated[
    Path | None,
    typer.Argument(metavar="SCENARIO", help="The scenario file, or a shipped one by name.", show_default=False),
]
FleetOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--fleet", "-f", envvar=FLEET_VARIABLE, show_default=False, help="The fleet file, or a shipped one by name."
    ),
]
SettingsOption: TypeAlias = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="The value of a parameter; may be given several times."),
]
BindingsOption: TypeAlias = Annotated[
    list[str] | None,
    typer.Option("--bind", metavar="ROLE=ROBOT,...", help="Who takes a role, in place of what the scenario says."),
]
DryRunOption: TypeAlias = Annotated[
    bool, typer.Option("--dry-run", help="Check everything and print what would happen; nothing moves.")
]
ResumeOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(metavar="RUN", help="Go on with the run of this folder, whose controller died.", show_default=False),
]
EventsOption: TypeAlias = Annotated[
    str | None, typer.Option(metavar="FILE|-", help="Write what happens as JSON lines; - is stdout.")
]
RecordOption: TypeAlias = Annotated[
    Extent, typer.Option(help="What run.mcap holds: poses; the values of all sensors too; or frames as well.")
]
RunsDirOption: TypeAlias = Annotated[Path, typer.Option(help="Where the run's folder is made.")]
SeedOption: TypeAlias = Annotated[
    int | None, typer.Option(min=0, help="Seed of all randomness, in place of the fleet file's.")
]
RateOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        metavar="NUMBER|max",
        help="Fleet seconds in one real second, in place of the fleet file's; max is as fast as it goes.",
    ),
]
NoPlotOption: TypeAlias = Annotated[bool, typer.Option("--no-plot", help="Draw no picture of the paths.")]
ShowOption: TypeAlias = Annotated[bool, typer.Option("--show", help="Open the picture, where there is a desktop.")]
