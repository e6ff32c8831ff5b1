"""`eal discover`: robots on this network that let themselves be found."""

from __future__ import annotations

from typing import Annotated, Final

import typer
from rich.text import Text

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.options import JsonOption
from eal_actors.cli.output import new_table, stderr, stdout, write_json
from eal_actors.net.controller.discovery import Discovery, discover

_NOTHING: Final = """\
No robot was found. Robots and routers answer only if
- their fleet file says so, under network: `discovery: true`;
- they listen at an address that others can reach, such as tcp/0.0.0.0:50000, and not at 127.0.0.1;
- multicast passes between them and this machine (224.0.0.224, UDP port 7446), as it does in most wired networks;
- they need no certificates.
Robots that stand in a fleet file need not be found: `eal ping --fleet FLEET` shows which of them are there."""


def discover_robots(
    timeout: Annotated[
        float, typer.Option("--timeout", metavar="SECONDS", min=0.1, max=60.0, help="How long to wait for answers.")
    ] = 2.0,
    as_json: JsonOption = False,
) -> None:
    """Find robots by multicast, where their fleet files allow it (`network: {discovery: true}`).

    Ends with 1 if none was found.
    """
    found = discover(timeout)
    if as_json:
        robots = [{"fleet": entry.fleet, "robot": entry.robot, "endpoint": entry.endpoint} for entry in found.robots]
        write_json({"robots": robots, "closed": list(found.closed)})
    else:
        _print(found)
    if not found.robots:
        raise typer.Exit(ExitCode.FAILED)


def _print(found: Discovery) -> None:
    if found.robots:
        table = new_table("fleet", "robot", "endpoint")
        for entry in found.robots:
            table.add_row(entry.fleet, Text(entry.robot, style="cyan"), entry.endpoint)
        stdout().print(table)
    else:
        stderr().print(Text(_NOTHING), soft_wrap=True)
    for endpoint in found.closed:
        what = f"{endpoint} tells nothing: it wants certificates, or no robot is there"
        stderr().print(Text(what, style="dim"), soft_wrap=True)
