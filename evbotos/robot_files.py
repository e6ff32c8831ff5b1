"""A robot's own files, provided by its owner, on the boot partition."""

from __future__ import annotations

import hashlib
from pathlib import Path

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_public_key

from evbotos.errors import BuildError
from evbotos.model import Local


def gather_robot_files(local: Local) -> dict[str, tuple[str, bytes]]:
    """Return the files of `robot/` on the boot partition: hash and content by name.

    Raises:
        BuildError: a file that local.yaml names is missing or invalid.
    """
    contents: dict[str, bytes] = {}
    if local.robot is not None:
        folder = Path(local.robot)
        if not folder.is_dir():
            raise BuildError(f"local.yaml: robot: there is no folder {folder}")
        contents = {
            path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()
        }
    if local.ssh_keys:
        contents["authorized_keys"] = "".join(f"{key.strip()}\n" for key in local.ssh_keys).encode()
    if local.update_key is not None:
        contents["update_key"] = public_key_hex(Path(local.update_key)).encode()
    return {name: (hashlib.sha256(content).hexdigest(), content) for name, content in contents.items()}


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
