"""`eal keys`: make and list the certificates of a fleet, and write the security section of its file."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.text import Text

from eal_actors.cli.options import EalCommand, EalCommandGroup, FleetOption, JsonOption
from eal_actors.cli.output import new_table, print_line, stderr, stdout, write_json
from eal_actors.kernel.bundled import find_file, short_path
from eal_actors.kernel.clock import wall_time
from eal_actors.kernel.errors import ConfigError, RobotNotFoundError, writing
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.kernel.yaml_source import load_yaml
from eal_actors.lab.fleet_edits import replace_file, with_security
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_loader import load_fleet
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.keys.certificates import (
    AUTHORITY,
    DEFAULT_FOLDER,
    VALID,
    Certificate,
    certificate_file,
    folder_of,
    key_file,
    list_certificates,
    make_authority,
    make_certificate,
)
from eal_actors.managers.keys.expiry import day_or_minute, expires_soon, time_left
from eal_actors.managers.keys.revocation import REVOKED, require_not_revoked, revoked_names
from eal_actors.managers.network_model import BEHIND_ROUTER, parse_endpoint

app = typer.Typer(
    cls=EalCommandGroup, help="Make the certificates that secure a fleet's network.", no_args_is_help=True
)

_LIFETIME_UNITS: Final = {"h": timedelta(hours=1), "d": timedelta(days=1)}
_SECTION: Final = """\
network:
  security:
    keys: {keys}
    controller: controller
    roles:
      controllers: [controller]
      observers: []
      routers: [{routers}]
"""

ForceOption = Annotated[bool, typer.Option("--force", help="Replace existing files.")]
HostOption = Annotated[
    list[str] | None, typer.Option("--host", help="Additional host name or address of the certificate; repeatable.")
]
ValidOption = Annotated[
    str | None,
    typer.Option(
        "--valid-for",
        metavar="TIME",
        show_default="825d",
        help="Lifetime in hours or days, such as 8h for a shift or 90d.",
    ),
]
DirOption = Annotated[
    Path | None, typer.Option("--dir", show_default="from the fleet file, or keys beside it", help="Folder of keys.")
]


@app.command("init", cls=EalCommand)
def init_keys(
    fleet: FleetOption,
    directory: DirOption = None,
    write: Annotated[
        bool, typer.Option("--write", help="Add the section to the fleet file, which must have no network.security.")
    ] = False,
    force: ForceOption = False,
) -> None:
    """Make the fleet's certificate authority, and print the fleet file's section that turns security on.

    With security, addresses in the file must begin with tls/ or quic/. --write changes the file only if the result is
    valid, and keeps its content.
    """
    fleet = find_file(fleet, "fleet")
    root = load_yaml(fleet).root
    network = root.get("network")
    network = network if isinstance(network, dict) else {}
    folder = directory or fleet.parent / _named_folder(network)
    keys = Path(os.path.relpath(folder, fleet.parent)).as_posix()
    section = _SECTION.format(keys=keys, routers="router" if network.get("routers") else "")
    new = _add_section(fleet, section) if write else None  # fails before a file is made
    made = make_authority(folder, str(root.get("name", fleet.stem)), force=force)
    (folder / REVOKED).unlink(missing_ok=True)  # it names certificates of the former authority
    if not (ignore := folder / ".gitignore").exists():
        ignore.write_text("*.key\n", encoding="utf-8")
    if new is not None:
        replace_file(fleet, new)
        advise(f"{fleet}: section network.security added")
    else:
        stdout().print(Text(section), end="", soft_wrap=True)
    print_made(made)
    advise(f"{short_path(key_file(folder, AUTHORITY))} signs certificates: keep it secret, and on this machine.")
    advise(f"Next: eal keys controller controller --fleet {fleet}, and eal keys robot ROBOT for each robot.")


@app.command("robot", cls=EalCommand)
def robot_keys(
    names: Annotated[list[str], typer.Argument(metavar="ROBOT...", help="Names of robots.")],
    fleet: FleetOption,
    host: HostOption = None,
    valid: ValidOption = None,
    directory: DirOption = None,
    force: ForceOption = False,
) -> None:
    """Make certificates for robots, valid for the hosts in their addresses."""
    config, folder = fleet_and_folder(fleet, directory)
    hosts = {name: [*_robot_hosts(config, name), *(host or [])] for name in names}  # fails before a file is made
    lifetime = parse_lifetime(valid) or VALID
    for name in names:
        require_not_revoked(folder, name)
    for name in names:
        print_to_copy(make_certificate(folder, name, hosts[name], valid=lifetime, force=force))


@app.command("controller", cls=EalCommand)
def controller_keys(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of a person or program.")],
    fleet: FleetOption,
    observer: Annotated[bool, typer.Option("--observer", help="Allow only reading and requests.")] = False,
    valid: ValidOption = None,
    directory: DirOption = None,
    force: ForceOption = False,
) -> None:
    """Make a certificate for a controller or an observer of the robots.

    The roles in the fleet file grant its rights, on every robot and router. The command prints what to add there.
    """
    config, folder = fleet_and_folder(fleet, directory)
    _require_no_robot(config, name)
    require_not_revoked(folder, name)
    print_to_copy(make_certificate(folder, name, valid=parse_lifetime(valid) or VALID, force=force))
    security = config.network.security
    role = "observer" if observer else "controller"
    if security is None or not any((grant.name, grant.role) == (name, role) for grant in security.grants):
        advise(f"Next: add {name} to network.security.roles.{role}s in the fleet file, here and on the robots.")
    advise(f"Programs use it if the fleet file has network.security.controller: {name}")


@app.command("router", cls=EalCommand)
def router_keys(
    fleet: FleetOption,
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the router.")] = "router",
    host: HostOption = None,
    valid: ValidOption = None,
    directory: DirOption = None,
    force: ForceOption = False,
) -> None:
    """Make a certificate for a router, valid for the hosts in network.routers of the fleet file."""
    config, folder = fleet_and_folder(fleet, directory)
    _require_no_robot(config, name)
    require_not_revoked(folder, name)
    hosts = [*(parse_endpoint(endpoint).host for endpoint in config.network.routers), *(host or [])]
    if not hosts:
        why = "network.routers of the fleet file is empty: name the router's host"
        raise typer.BadParameter(why, param_hint="--host")
    print_to_copy(make_certificate(folder, name, hosts, valid=parse_lifetime(valid) or VALID, force=force))
    if config.network.security is None or name not in config.network.security.routers:
        advise(f"Next: add {name} to network.security.roles.routers in the fleet file, here and on the robots.")


@app.command("list", cls=EalCommand)
def show_keys(fleet: FleetOption, directory: DirOption = None, as_json: JsonOption = False) -> None:
    """List the certificates with their rights and expiry dates."""
    config, folder = fleet_and_folder(fleet, directory)
    revoked = revoked_names(folder)
    found: list[dict[str, Any]] = [
        {
            "name": certificate.name,
            "hosts": list(certificate.hosts),
            "begins": certificate.begins.isoformat(),
            "expires": certificate.expires.isoformat(),
            "days_left": certificate.days_left,
            "file": str(short_path(certificate.file)),
            "revoked": certificate.name in revoked,
            "may": "" if certificate.name in revoked else _rights(config, certificate.name),
        }
        for certificate in list_certificates(folder)
    ]
    if as_json:
        write_json({"certificates": found})
        return
    table = new_table("name", "hosts", "may", "expires", "file")
    for entry in found:
        ends, now = datetime.fromisoformat(entry["expires"]), wall_time()
        is_soon = expires_soon(datetime.fromisoformat(entry["begins"]), ends, now)
        expires = Text(f"{ends:%Y-%m-%d}, {'revoked' if entry['revoked'] else time_left(ends, now)}")
        expires.style = "red" if ends < now or entry["revoked"] else "yellow" if is_soon else ""
        name, hosts = Text(entry["name"], style="cyan"), "\n".join(entry["hosts"])
        table.add_row(name, hosts, entry["may"], expires, entry["file"])
    stdout().print(table)


def fleet_and_folder(fleet: Path, directory: Path | None) -> tuple[FleetConfig, Path]:
    """Return the fleet of a file, and the folder of its keys, in place of which `--dir` may name another."""
    config = EALConfigManager.load(fleet).fleet
    return config, directory or folder_of(config)


def parse_lifetime(text: str | None) -> timedelta | None:
    """Return the lifetime of `--valid-for`; None if it was not given.

    Raises BadParameter if it is no lifetime from one hour to ten years.
    """
    if text is None:
        return None
    match = re.fullmatch(r"([0-9]{1,6})([hd])", text)
    lifetime = timedelta() if match is None else int(match[1]) * _LIFETIME_UNITS[match[2]]
    if not timedelta(hours=1) <= lifetime <= timedelta(days=3650):
        raise typer.BadParameter(f"{text!r} is no time from 1h to 3650d, such as 8h or 90d", param_hint="--valid-for")
    return lifetime


def _named_folder(network: dict[str, Any]) -> str:
    security = network.get("security")
    named = security.get("keys") if isinstance(security, dict) else None
    return named if isinstance(named, str) and named else DEFAULT_FOLDER


def _add_section(fleet: Path, section: str) -> str:
    """Return the fleet file's text with the section added; raise ConfigError if the result is not valid."""
    new = with_security(fleet.read_text(encoding="utf-8"), str(fleet), section)
    trial = fleet.with_name(f".{fleet.name}.new")
    try:
        with writing(fleet):
            trial.write_text(new, encoding="utf-8")
        load_fleet(trial, os.environ)
    except ConfigError as error:
        names = {str(trial): str(fleet)}
        raise ConfigError([replace(one, file=names.get(one.file, one.file)) for one in error.problems]) from None
    finally:
        trial.unlink(missing_ok=True)
    return new


def _robot_hosts(fleet: FleetConfig, name: str) -> Sequence[str]:
    if (robot := fleet.robots.get(name)) is None:
        raise RobotNotFoundError(f"the fleet has no robot '{name}'{did_you_mean(name, fleet.robots)}")
    if robot.address is None:
        why = f"{name} has no address: it runs in the controller's process and needs no keys"
        raise typer.BadParameter(why, param_hint="ROBOT")
    return [] if robot.address == BEHIND_ROUTER else [parse_endpoint(robot.address).host]


def _require_no_robot(fleet: FleetConfig, name: str) -> None:
    if name in fleet.robots:
        why = f"{name} is a robot, and a robot's certificate has no other role; choose another name"
        raise typer.BadParameter(why, param_hint="NAME")


def _rights(fleet: FleetConfig, name: str) -> str:
    security = fleet.network.security
    if name in fleet.robots:
        return "be the robot"
    if security is None or name == AUTHORITY:
        return ""
    if name in security.routers:
        return "route"
    rights = {"controller": "command", "observer": "read"}
    return "; ".join(
        " ".join([rights[grant.role], *(grant.robots or ()), *(grant.resources or ())])
        for grant in security.grants
        if grant.name == name
    )


def print_made(certificate: Certificate) -> None:
    """Print what was made."""
    hosts = f" for {', '.join(certificate.hosts)}" if certificate.hosts else ""
    until = day_or_minute(certificate.expires, wall_time())
    print_line(stderr(), f"{short_path(certificate.file)}: made{hosts}, valid until {until}")


def print_to_copy(certificate: Certificate) -> None:
    """Print what was made, and which files its owner needs."""
    print_made(certificate)
    folder, name = certificate.file.parent, certificate.name
    files = (certificate_file(folder, AUTHORITY), certificate.file, key_file(folder, name))
    advise(f"{name} needs {', '.join(str(short_path(file)) for file in files)}")


def advise(text: str) -> None:
    """Print advice."""
    print_line(stderr(), text, "dim")
