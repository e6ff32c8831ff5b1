"""`evbotos fleet update`: a new system for the robots of a fleet, over the fleet's own network."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from eal_actors import Fleet
from eal_actors.kernel.bundled import bundled_path
from evbotos.errors import UpdateError
from evbotos.fleet_robots import FleetRobots, read_update
from evbotos.fleet_update import Outcome, summary, update_fleet
from evbotos.options import JsonOption
from evbotos.robot_files import served_robots
from evbotos.terminal import console, write_json

fleet_app = typer.Typer(help="Operations on the machines of a fleet.", no_args_is_help=True)


@fleet_app.callback()
def fleet_operations() -> None:
    """Operations on the machines of a fleet."""


@fleet_app.command("update")
def update(
    fleet: Annotated[Path, typer.Argument(metavar="FLEET", help="The fleet file.", show_default=False)],
    updates: Annotated[
        list[Path],
        typer.Argument(metavar="UPDATE...", help="Files of `evbotos slot`, one a platform.", show_default=False),
    ],
    robots: Annotated[
        list[str] | None, typer.Option("--robot", "-r", help="Which robots.", show_default="all with an address")
    ] = None,
    check: Annotated[
        str | None, typer.Option("--check", help="A scenario that each updated robot must pass alone.")
    ] = None,
    group: Annotated[int, typer.Option("--group", min=1, help="Robots that are updated at the same time.")] = 1,
    wait: Annotated[bool, typer.Option("--wait", help="Wait for robots that are absent or in use.")] = False,
    restart_s: Annotated[
        float, typer.Option("--restart-s", min=1, help="Longest time of a restart, in seconds.")
    ] = 300.0,
    as_json: JsonOption = False,
) -> None:
    """Update the robots of a fleet, one group after the other, over the fleet's own network.

    Only blocks that a robot lacks are sent. It restarts, must serve with all its resources and pass the scenario;
    otherwise it returns to its former system, and the other robots are left alone. Run the same command again to go on.
    """
    if not fleet.is_file():
        raise UpdateError(f"there is no fleet file {fleet}")
    scenario = _scenario(check) if check is not None else None
    made = [read_update(path) for path in updates]
    served = served_robots(fleet)
    names = robots or served
    if unknown := [name for name in names if name not in served]:
        raise UpdateError(f"{fleet} has no robot with an address named {', '.join(unknown)}")
    out = console(error=as_json)
    with Fleet.load(fleet).connect(names) as connected:
        found = FleetRobots(connected, fleet, scenario, lambda robot, words: out.print(f"{robot}: {words}"))
        found.wait_for(names)
        outcomes = update_fleet(found, names, made, group=group, wait=wait, restart_s=restart_s)
    if as_json:
        write_json({name: outcome.value for name, outcome in outcomes.items()})
    else:
        out.print(summary(outcomes), soft_wrap=True)
    if set(outcomes.values()) - {Outcome.UPDATED}:
        raise typer.Exit(1)


def _scenario(name: str) -> Path:
    path = Path(name) if Path(name).is_file() else bundled_path("scenarios") / f"{name}.yaml"
    if not path.is_file():
        raise UpdateError(f"there is no scenario {name}")
    return path
