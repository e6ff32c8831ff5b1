"""A robot's own files, provided by its owner, on the boot partition."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_public_key

from eal_actors.kernel.errors import ConfigError
from eal_actors.kernel.yaml_source import load_yaml
from evbotos import wireless
from evbotos.errors import BuildError
from evbotos.model import Local
from evbotos.private_keys import needed_files


def gather_robot_files(local: Local) -> tuple[dict[str, tuple[str, bytes]], list[str]]:
    """Return the files of `robot/` on the boot partition, hash and content by name, and the names of those left out.

    Raises:
        BuildError: a file that local.yaml names is missing or invalid, or must not be on a robot.
    """
    contents: dict[str, bytes] = {}
    left_out: list[str] = []
    if local.robot is not None:
        folder = Path(local.robot)
        if not folder.is_dir():
            raise BuildError(f"local.yaml: robot: there is no folder {folder}")
        found = {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        try:
            contents, left_out = needed_files(found, _robot_of(folder))
        except BuildError as error:
            raise BuildError(f"local.yaml: robot: {folder}/{error.message}") from None
    contents |= access_files(local)
    return {name: (hashlib.sha256(content).hexdigest(), content) for name, content in contents.items()}, left_out


def access_files(local: Local) -> dict[str, bytes]:
    """Return the files that say who may log in, whose updates are accepted, and which wireless networks to join.

    Raises:
        BuildError: the key of updates is missing or invalid.
    """
    contents: dict[str, bytes] = {}
    if local.ssh_keys:
        contents["authorized_keys"] = "".join(f"{key.strip()}\n" for key in local.ssh_keys).encode()
    if local.update_key is not None:
        contents["update_key"] = public_key_hex(Path(local.update_key)).encode()
    if local.wifi is not None:
        contents[wireless.FILE] = wireless.configuration(local.wifi).encode()
    return contents


def _robot_of(folder: Path) -> str | None:
    """Return the name of the robot: that in `name`, else the only one with an address."""
    name, fleet = folder / "name", folder / "fleet.yaml"
    if name.is_file():
        return name.read_text().strip()
    if not fleet.is_file():
        return None
    served = served_robots(fleet)
    if len(served) > 1:
        raise BuildError(f"local.yaml: robot: which of {', '.join(served)} is it? Write its name into {name}")
    return served[0] if served else None


def served_robots(fleet: Path) -> list[str]:
    """Return the names of the robots with an address.

    Raises:
        BuildError: the file is not a fleet file.
    """
    return [name for name, robot in robots_of(fleet).items() if isinstance(robot, dict) and "address" in robot]


def robots_of(fleet: Path) -> dict[str, Any]:
    """Return the robots of a fleet file, as it defines them.

    Raises:
        BuildError: the file is not a fleet file.
    """
    try:
        robots = load_yaml(fleet).root.get("robots")
    except ConfigError as error:
        raise BuildError("\n".join(str(problem) for problem in error.problems)) from None
    return dict(robots) if isinstance(robots, dict) else {}


def public_key_hex(path: Path) -> str:
    """Return a public key as 64 hex digits, the robot's format.

    Raises:
        BuildError: the file is missing or contains no public ed25519 key in PEM.
    """
    try:
        key = load_pem_public_key(path.read_bytes())
    except OSError as error:
        raise BuildError(f"local.yaml: update_key: {error}") from error
    except (ValueError, UnsupportedAlgorithm):
        key = None
    if not isinstance(key, Ed25519PublicKey):
        raise BuildError(f"local.yaml: update_key: {path} is not a public ed25519 key in PEM")
    return key.public_bytes(Encoding.Raw, PublicFormat.Raw).hex()
