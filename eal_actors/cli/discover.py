"""`eal discover`: list robots that answer discovery on this network."""

from __future__ import annotations

from typing import Annotated, Final

import typer
from rich.text import Text

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.options import JsonOption
from eal_actors.cli.output import new_table, print_line, stderr, stdout, write_json
from eal_actors.wire.rpc.client.discovery import discover

_NOTHING: Final = """\
No robot was found. A robot or router answers only if
- its fleet file has `discovery: true` under network;
- it listens at an address that this machine can reach, such as tcp/0.0.0.0:50000, and not at 127.0.0.1;
- multicast (224.0.0.224, UDP port 7446) passes between it and this machine, as in most wired networks;
- it needs no certificates.
Robots of a fleet file need no discovery: `eal ping --fleet FLEET` shows which of them answer."""


def discover_robots(
    timeout: Annotated[
        float, typer.Option("--timeout", metavar="SECONDS", min=0.1, max=60.0, help="Time to wait for answers.")
    ] = 2.0,
    as_json: JsonOption = False,
) -> None:
    """Find robots by multicast whose fleet files allow it (`network: {discovery: true}`).

    The exit code is 1 if no robot was found.
    """
    found = discover(timeout)
    if as_json:
        write_json({"robots": [entry._asdict() for entry in found.robots], "closed": list(found.closed)})
    else:
        if found.robots:
            table = new_table("fleet", "identity", "robot", "endpoint")
            for entry in found.robots:
                table.add_row(entry.fleet, entry.identity or "", Text(entry.robot, style="cyan"), entry.endpoint)
            stdout().print(table)
        else:
            print_line(stderr(), _NOTHING)
        for endpoint in found.closed:
            print_line(stderr(), f"{endpoint} gave no answer: it needs certificates, or has no robot", "dim")
    if not found.robots:
        raise typer.Exit(ExitCode.FAILED)
