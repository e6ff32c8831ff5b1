"""`eal keys renew` and `eal keys revoke`: the end of a certificate, put off or brought forward, without a restart."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.keys import DirOption, ValidOption, advise, fleet_and_folder, parse_lifetime, print_to_copy
from eal_actors.cli.keys import app as keys_app
from eal_actors.cli.options import EalCommand, FleetOption
from eal_actors.cli.output import print_line, stderr, stdout
from eal_actors.kernel.clock import wall_time
from eal_actors.kernel.errors import EALError
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.keys.certificates import AUTHORITY, list_certificates, make_pass, renew_certificate
from eal_actors.managers.keys.expiry import expires_soon
from eal_actors.managers.keys.revocation import require_not_revoked, revoke, revoked_names
from eal_actors.wire.format import keys
from eal_actors.wire.rpc.client.broadcast import ask_robots

app = keys_app


@app.command("renew", cls=EalCommand)
def renew_keys(
    fleet: FleetOption,
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]...", help="Names; all that are about to expire if left out.")
    ] = None,
    valid: ValidOption = None,
    directory: DirOption = None,
) -> None:
    """Renew certificates, each for the same hosts and with a new key.

    Copy the new files to where the old ones are: robots and routers follow within two seconds, without a restart.
    """
    _, folder = fleet_and_folder(fleet, directory)
    revoked = revoked_names(folder)
    present = {made.name: made for made in list_certificates(folder) if made.name != AUTHORITY}
    wanted = names or [
        made.name
        for made in present.values()
        if made.name not in revoked and expires_soon(made.begins, made.expires, wall_time())
    ]
    _require_known(wanted, present)
    if not wanted:
        print_line(stderr(), "No certificate is about to expire; name one to renew it all the same.")
    for name in wanted:
        require_not_revoked(folder, name)
    for name in wanted:
        print_to_copy(renew_certificate(folder, name, parse_lifetime(valid)))


@app.command("revoke", cls=EalCommand)
def revoke_keys(
    fleet: FleetOption,
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]...", help="Names; the whole list is sent again if left out.")
    ] = None,
    directory: DirOption = None,
) -> None:
    """Revoke certificates on all robots and routers at once, without a restart.

    What their owners command is halted and their links are closed. A name stays revoked; use another one for a
    successor. Exits with 1 if a robot did not confirm: run the command again, without names, when it is back.
    """
    config, folder = fleet_and_folder(fleet, directory)
    _require_known(names or [], {made.name for made in list_certificates(folder)} | set(config.robots) - {AUTHORITY})
    with TemporaryDirectory(prefix="eal-keys-") as place:
        make_pass(folder, Path(place), keys.AUTHORITY_CALLER)  # fails before anything is stored
        if not (revoked := sorted(revoke(folder, names or ()))):
            print_line(stderr(), "No certificate is revoked.")
            return
        print_line(stdout(), f"revoked: {', '.join(revoked)}")
        errors = _send(config, Path(place), tuple(revoked))
    for robot, error in errors.items():
        print_line(stdout(), f"{robot}: stored and in force" if error is None else f"NOT CONFIRMED: {error}")
    security = config.network.security
    if security is not None and security.routers:
        advise("Routers that forwarded it have stored it too; check revoked.txt in their folder of keys.")
    advise("Programs that run follow revoked.txt in their own folder of keys: copy it there.")
    advise("Remove the names from the roles in the fleet file too.")
    if any(errors.values()):
        raise typer.Exit(ExitCode.FAILED)


def _send(config: FleetConfig, place: Path, names: tuple[str, ...]) -> dict[str, EALError | None]:
    """Send the names to all robots; returns the error of each that is not revoked itself, None where it confirmed."""
    security = config.network.security
    robots = [name for name, robot in config.robots.items() if robot.address is not None]
    errors: dict[str, EALError | None] = {}
    if security is None or not robots:
        return errors
    network = replace(config.network, security=replace(security, keys=place, controller=keys.AUTHORITY_CALLER))
    try:
        ask_robots(replace(config, network=network), robots, keys.REVOKE, names, on_result=errors.__setitem__)
    except EALError as error:  # no router answers
        errors.update({robot: error.at(robot) for robot in robots if robot not in errors})
    return {robot: error for robot, error in errors.items() if robot not in names}


def _require_known(names: list[str], known: Collection[str]) -> None:
    for name in names:
        if name not in known:
            raise typer.BadParameter(f"there is no certificate '{name}'{did_you_mean(name, known)}", param_hint="NAME")
