"""`eal schema`: the file formats, for editors that complete and check while one types."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from eal_actors.cli.output import write_json
from eal_actors.managers.config import fleet_schema, manifest_schema, world_schema
from eal_actors.scenario import scenario_schema


def print_schema(
    kind: Annotated[
        Literal["fleet", "scenario", "world", "plugin"], typer.Argument(help="The kind of file.", show_default=False)
    ],
) -> None:
    """Print the JSON Schema of a kind of file."""
    makers = {"fleet": fleet_schema, "scenario": scenario_schema, "world": world_schema, "plugin": manifest_schema}
    write_json(makers[kind]())
