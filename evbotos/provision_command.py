"""`evbotos provision`: an identity for each robot of a fleet, with certificates, SSH keys and the fleet file."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from eal_actors.kernel.yaml_source import load_yaml
from evbotos.definitions import load_definitions
from evbotos.errors import BuildError
from evbotos.identity import ENDING, address_hosts, host_key_in, identity_files, write_identity
from evbotos.options import JsonOption
from evbotos.robot_files import access_files, served_robots
from evbotos.shell import run
from evbotos.terminal import console, write_json

_FOLDER: Final = "identities"
_KNOWN: Final = "known_hosts"


def provision(
    fleet: Annotated[Path, typer.Argument(metavar="FLEET", show_default=False, help="The fleet file.")],
    robots: Annotated[
        list[str] | None, typer.Argument(metavar="[ROBOT]...", show_default="all with an address", help="Which robots.")
    ] = None,
    local: Annotated[
        Path | None, typer.Option("--local", help="Your settings: ssh_keys, update_key.", show_default="local.yaml")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder of identities.", show_default="beside the fleet file")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Make an identity for each robot of a fleet: one image serves them all.

    Missing certificates are made with `eal keys`. A repeated run keeps certificates and SSH host keys.
    """
    settings = load_definitions(local).local
    made = provision_fleet(fleet, robots, access_files(settings), output or fleet.parent / _FOLDER)
    if as_json:
        write_json({"identities": {robot: str(path) for robot, path in made.items()}})
        return
    out = console()
    for robot, path in made.items():
        out.print(f"{path}: {robot}, {path.stat().st_size / 1e3:.0f} kB", soft_wrap=True)
    first = next(iter(made.values()))
    out.print(f"Onto a card: evbotos flash disk.img /dev/sdX --identity {first}", soft_wrap=True)
    out.print("Or copy one file to a USB stick, and plug it into a machine with the image.", soft_wrap=True)
    if not settings.ssh_keys:
        out.print("Nobody may log in: local.yaml has no ssh_keys.", soft_wrap=True)


def provision_fleet(fleet: Path, robots: list[str] | None, access: dict[str, bytes], folder: Path) -> dict[str, Path]:
    """Make identities and the file `known_hosts` of their SSH keys.

    Args:
        fleet: the fleet file.
        robots: names; None or an empty list selects all robots with an address.
        access: who may log in, and whose updates are accepted.
        folder: the folder of the identities, created here.

    Returns:
        The identity of each robot.

    Raises:
        BuildError: the fleet is not secured, a robot is unknown, or its certificate cannot be made.
    """
    if not fleet.is_file():
        raise BuildError(f"there is no fleet file {fleet}")
    _require_security(fleet)
    served = served_robots(fleet)
    chosen = robots or served
    unknown = [robot for robot in chosen if robot not in served]
    if unknown or not chosen:
        raise BuildError(f"{fleet} has no robot with an address named {', '.join(unknown) or 'anything'}")
    _make_missing_keys(fleet, chosen)
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    made, known = {}, {}
    for robot in chosen:
        out = folder / f"{robot}{ENDING}"
        host_key = host_key_in(out) or Ed25519PrivateKey.generate()
        write_identity(identity_files(fleet, robot, access, host_key), out)
        made[robot] = out
        public = host_key.public_key().public_bytes(Encoding.OpenSSH, PublicFormat.OpenSSH).decode()
        known[robot] = f"{robot},{robot}.local,{address_hosts(fleet, robot)} {public}\n"
    _update_known(folder / _KNOWN, known)
    return made


def _update_known(file: Path, known: dict[str, str]) -> None:
    kept = file.read_text().splitlines(keepends=True) if file.is_file() else []
    kept = [line for line in kept if line.partition(",")[0] not in known]
    file.write_text("".join([*kept, *known.values()]))


def _require_security(fleet: Path) -> None:
    network = load_yaml(fleet).root.get("network")
    if not isinstance(network, dict) or not isinstance(network.get("security"), dict):
        raise BuildError(f"{fleet} is not secured: eal keys init --write --fleet {fleet}")


def _make_missing_keys(fleet: Path, robots: list[str]) -> None:
    listed: dict[str, Any] = json.loads(_eal_keys("list", "--json", fleet=fleet))
    present = {entry["name"] for entry in listed["certificates"] if not entry["revoked"]}
    missing = [robot for robot in robots if robot not in present]
    if missing:
        _eal_keys("robot", *missing, fleet=fleet)
    security = load_yaml(fleet).root["network"]["security"]
    controller = security.get("controller")
    if controller is not None and controller not in present:
        _eal_keys("controller", str(controller), fleet=fleet)


def _eal_keys(*words: str, fleet: Path) -> str:
    """Run `eal keys`, which alone makes certificates."""
    return run([sys.executable, "-P", "-m", "eal_actors", "keys", *words, "--fleet", fleet])
