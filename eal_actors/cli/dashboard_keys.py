"""`eal keys dashboard` and `eal keys operator`: HTTPS for the dashboard, and tokens for its users."""

from __future__ import annotations

import re
import socket
from typing import Annotated, Final

import typer

from eal_actors.cli.keys import DirOption, ForceOption, HostOption, advise, fleet_and_folder, print_made
from eal_actors.cli.keys_lifetime import app as keys_app
from eal_actors.cli.options import EalCommand, FleetOption
from eal_actors.cli.output import print_line, stderr, stdout
from eal_actors.kernel.bundled import short_path
from eal_actors.kernel.strict_model import NAME_PATTERN
from eal_actors.managers.fleet_model import OperatorRole
from eal_actors.managers.keys.certificates import AUTHORITY, DASHBOARD, certificate_file, make_certificate
from eal_actors.managers.missing_modules import needs_extra

_LOOPBACK: Final = ("localhost", "127.0.0.1", "::1")
app = keys_app


@app.command("dashboard", cls=EalCommand)
def make_dashboard_certificate(
    fleet: FleetOption, host: HostOption = None, directory: DirOption = None, force: ForceOption = False
) -> None:
    """Make the certificate with which `eal dashboard` serves HTTPS, valid for this machine's name and --host.

    Browsers must trust the fleet's authority: the command prints the file to import there.
    """
    _, folder = fleet_and_folder(fleet, directory)
    hosts = [*_LOOPBACK, socket.gethostname(), *(host or [])]
    print_made(make_certificate(folder, DASHBOARD, hosts, force=force))
    authority = short_path(certificate_file(folder, AUTHORITY))
    advise(f"Next: import {authority} into the operators' browsers as an authority for websites.")


@app.command("operator", cls=EalCommand)
def make_operator(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of a person.")],
    role: Annotated[
        OperatorRole,
        typer.Option(help="Each role includes those before it: see; stop and command; run scenarios; change settings."),
    ] = "drive",
) -> None:
    """Make the token of a user of the dashboard, and the lines for the fleet file, which keeps only its hash.

    The token goes to stdout and is in no file. Give it to the operator; the page asks for it.
    """
    with needs_extra("dashboard", "the dashboard needs"):
        from eal_actors.operate.dashboard.tokens import hash_token, new_token
    if not re.fullmatch(NAME_PATTERN, name):
        raise typer.BadParameter(
            "must be a letter (A-Z, a-z), then letters, digits, '_', '.' or '-'", param_hint="NAME"
        )
    token = new_token()
    advise("Add to the fleet file:")
    lines = ("dashboard:", "  operators:", f"    {name}: {{role: {role}, token: {hash_token(token)}}}")
    for line in lines:
        print_line(stderr(), line)
    advise(f"Token of {name}, shown only now:")
    print_line(stdout(), f"{name}.{token}")
