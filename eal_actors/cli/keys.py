"""`eal keys`: the certificates of a fleet, and the part of its file that makes use of them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.text import Text

from eal_actors.cli.help import Command, Group
from eal_actors.cli.options import FleetOption, JsonOption
from eal_actors.cli.output import new_table, short_path, stderr, stdout, write_json
from eal_actors.kernel.errors import ConfigError, Problem, RobotNotFoundError
from eal_actors.kernel.strict_model import did_you_mean
from eal_actors.kernel.yaml_source import load_yaml
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_loader import load_fleet
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.network_model import BEHIND_ROUTER, parse_endpoint
from eal_actors.net.security.certificates import (
    AUTHORITY,
    Certificate,
    certificate_file,
    key_file,
    list_certificates,
    make_authority,
    make_certificate,
)

app = typer.Typer(cls=Group, help="Make the certificates that secure a fleet's network.", no_args_is_help=True)

DEFAULT_FOLDER: Final = "keys"
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

ForceOption = Annotated[bool, typer.Option("--force", help="Replace what is there.")]
HostOption = Annotated[
    list[str] | None,
    typer.Option(
        "--host", show_default=False, help="A further name or address at which it is reached; may be repeated."
    ),
]
DirOption = Annotated[
    Path | None,
    typer.Option("--dir", show_default="as the fleet file says, or keys beside it", help="The folder of keys."),
]


@app.command("init", cls=Command)
def init_keys(
    fleet: FleetOption,
    directory: DirOption = None,
    write: Annotated[
        bool, typer.Option("--write", help="Append the section to the fleet file, which must not have one yet.")
    ] = False,
    force: ForceOption = False,
) -> None:
    """Make the fleet's authority, and print the section of the fleet file that turns security on.

    Addresses in the file must begin with tls/ or quic/ then. A file that is written to is changed only if it is
    valid afterwards; what is in it stays as it is.
    """
    root = load_yaml(fleet).root
    network = root.get("network")
    network = network if isinstance(network, dict) else {}
    folder = directory or fleet.parent / _named_folder(network)
    keys = Path(os.path.relpath(folder, fleet.parent)).as_posix()
    section = _SECTION.format(keys=keys, routers="router" if network.get("routers") else "")
    new = _appended(fleet, section) if write else None  # before anything is made
    made = make_authority(folder, str(root.get("name", fleet.stem)), force=force)
    _keep_out_of_git(folder)
    if new is not None:
        _replace(fleet, new)
    else:
        stdout().print(Text(section), end="", soft_wrap=True)
    _tell_made(made)
    _advise(f"{short_path(key_file(folder, AUTHORITY))} makes certificates: keep it here, and secret.")
    _advise(f"Next: eal keys controller controller --fleet {fleet}, and eal keys robot ROBOT for each robot.")


@app.command("robot", cls=Command)
def robot_keys(
    names: Annotated[list[str], typer.Argument(metavar="ROBOT...", show_default=False, help="Names of robots.")],
    fleet: FleetOption,
    host: HostOption = None,
    directory: DirOption = None,
    force: ForceOption = False,
) -> None:
    """Make certificates for robots, good for the hosts in their addresses."""
    config = EALConfigManager.load(fleet).fleet
    folder = directory or _folder(config)
    hosts = {name: [*_hosts_of(config, name), *(host or [])] for name in names}  # before anything is made
    for name in names:
        made = make_certificate(folder, name, hosts[name], force=force)
        _tell_made(made)
        _advise_to_copy(folder, name)


@app.command("controller", cls=Command)
def controller_keys(
    name: Annotated[str, typer.Argument(metavar="NAME", show_default=False, help="Name of a person or program.")],
    fleet: FleetOption,
    observer: Annotated[bool, typer.Option("--observer", help="It shall read only.")] = False,
    directory: DirOption = None,
    force: ForceOption = False,
) -> None:
    """Make a certificate for whoever commands the robots, or observes them.

    The roles in the fleet file say what it may do, on every robot and router; what to add there is printed.
    """
    config = EALConfigManager.load(fleet).fleet
    _require_no_robot(config, name)
    folder = directory or _folder(config)
    _tell_made(make_certificate(folder, name, force=force))
    _advise_to_copy(folder, name)
    security = config.network.security
    role = "observer" if observer else "controller"
    if security is None or not any((grant.name, grant.role) == (name, role) for grant in security.grants):
        _advise(f"Next: add {name} to network.security.roles.{role}s in the fleet file, here and on the robots.")
    _advise(f"Programs dial with it where the fleet file says network.security.controller: {name}")


@app.command("router", cls=Command)
def router_keys(
    fleet: FleetOption,
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the router.")] = "router",
    host: HostOption = None,
    directory: DirOption = None,
    force: ForceOption = False,
) -> None:
    """Make a certificate for a router, good for the hosts in the fleet file's list of routers."""
    config = EALConfigManager.load(fleet).fleet
    _require_no_robot(config, name)
    folder = directory or _folder(config)
    hosts = [*(parse_endpoint(endpoint).host for endpoint in config.network.routers), *(host or [])]
    if not hosts:
        raise typer.BadParameter("the fleet file names no routers; say where this one is reached", param_hint="--host")
    _tell_made(make_certificate(folder, name, hosts, force=force))
    _advise_to_copy(folder, name)
    if config.network.security is None or name not in config.network.security.routers:
        _advise(f"Next: add {name} to network.security.roles.routers in the fleet file, here and on the robots.")


@app.command("list", cls=Command)
def show_keys(fleet: FleetOption, directory: DirOption = None, as_json: JsonOption = False) -> None:
    """List the certificates, what their owners may do, and when they expire."""
    config = EALConfigManager.load(fleet).fleet
    found = [
        {**_described(certificate), "may": _may(config, certificate.name)}
        for certificate in list_certificates(directory or _folder(config))
    ]
    if as_json:
        write_json({"certificates": found})
        return
    table = new_table("name", "hosts", "may", "expires", "file")
    for entry in found:
        left = entry["days_left"]
        ends = Text(f"{entry['expires'][:10]}, in {left} days" if left >= 0 else f"{entry['expires'][:10]}, expired")
        ends.style = "red" if left < 0 else "yellow" if left < 30 else ""
        table.add_row(Text(entry["name"], style="cyan"), "\n".join(entry["hosts"]), entry["may"], ends, entry["file"])
    stdout().print(table)


def _named_folder(network: dict[str, Any]) -> str:
    security = network.get("security")
    named = security.get("keys") if isinstance(security, dict) else None
    return named if isinstance(named, str) and named else DEFAULT_FOLDER


def _appended(fleet: Path, section: str) -> str:
    """Return the fleet file with the section at its end, if it is valid then; else raise ConfigError."""
    root = load_yaml(fleet).root
    if "network" in root:
        raise ConfigError([_problem(fleet, "there is a network section already: leave out --write, and add by hand")])
    text = fleet.read_text(encoding="utf-8")
    new = f"{text}{'' if text.endswith(chr(10)) else chr(10)}\n{section}"
    trial = fleet.with_name(f".{fleet.name}.new")
    try:
        trial.write_text(new, encoding="utf-8")
        load_fleet(trial, os.environ)
    except ConfigError as error:
        problems = [
            Problem(str(fleet) if problem.file == str(trial) else problem.file, *_after_file(problem))
            for problem in error.problems
        ]
        raise ConfigError(problems) from None
    except OSError as error:
        raise ConfigError([_problem(fleet, f"cannot be written: {error.strerror}")]) from error
    finally:
        trial.unlink(missing_ok=True)
    return new


def _after_file(problem: Problem) -> tuple[int, int, str, str]:
    return problem.line, problem.column, problem.path, problem.message


def _replace(file: Path, text: str) -> None:
    """Write a file as a whole or not at all, with the permissions it has."""
    trial = file.with_name(f".{file.name}.new")
    try:
        trial.write_text(text, encoding="utf-8")
        trial.chmod(file.stat().st_mode & 0o777)
        trial.replace(file.resolve())
    except OSError as error:
        raise ConfigError([_problem(file, f"cannot be written: {error.strerror}")]) from error
    _advise(f"{file}: the network section was added at the end")


def _keep_out_of_git(folder: Path) -> None:
    ignore = folder / ".gitignore"
    if not ignore.exists():
        ignore.write_text("*.key\n", encoding="utf-8")


def _folder(fleet: FleetConfig) -> Path:
    security = fleet.network.security
    return fleet.source.parent / DEFAULT_FOLDER if security is None else security.keys


def _hosts_of(fleet: FleetConfig, name: str) -> Sequence[str]:
    robot = fleet.robots.get(name)
    if robot is None:
        raise RobotNotFoundError(f"the fleet has no robot '{name}'{did_you_mean(name, fleet.robots)}")
    if robot.address is None:
        why = f"{name} has no address: it lives in the controller's process and needs no keys"
        raise typer.BadParameter(why, param_hint="ROBOT")
    return [] if robot.address == BEHIND_ROUTER else [parse_endpoint(robot.address).host]


def _require_no_robot(fleet: FleetConfig, name: str) -> None:
    if name in fleet.robots:
        why = f"{name} is a robot, whose certificate has no other role; choose another name"
        raise typer.BadParameter(why, param_hint="NAME")


def _may(fleet: FleetConfig, name: str) -> str:
    security = fleet.network.security
    if name in fleet.robots:
        return "be the robot"
    if security is None or name == AUTHORITY:
        return ""
    if name in security.routers:
        return "route"
    words = {"controller": "command", "observer": "read"}
    return "; ".join(
        " ".join([words[grant.role], *(grant.robots or ()), *(grant.resources or ())])
        for grant in security.grants
        if grant.name == name
    )


def _described(certificate: Certificate) -> dict[str, Any]:
    return {
        "name": certificate.name,
        "hosts": list(certificate.hosts),
        "expires": certificate.expires.isoformat(),
        "days_left": certificate.days_left,
        "file": str(short_path(certificate.file)),
    }


def _tell_made(certificate: Certificate) -> None:
    where = f" for {', '.join(certificate.hosts)}" if certificate.hosts else ""
    text = f"{short_path(certificate.file)}: made{where}, good until {certificate.expires:%Y-%m-%d}"
    stderr().print(Text(text), soft_wrap=True)


def _advise_to_copy(folder: Path, name: str) -> None:
    files = (certificate_file(folder, AUTHORITY), certificate_file(folder, name), key_file(folder, name))
    _advise(f"{name} needs {', '.join(str(short_path(file)) for file in files)}")


def _advise(text: str) -> None:
    stderr().print(Text(text, style="dim"), soft_wrap=True)


def _problem(file: Path, message: str) -> Problem:
    return Problem(str(file), 0, 0, "", message)
