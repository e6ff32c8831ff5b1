"""What makes one robot of an image: the files on the boot partition that its owner gives it."""

from __future__ import annotations

import hashlib
from pathlib import Path

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_public_key

from evbotos.errors import BuildError
from evbotos.model import Local


def gather_robot_files(local: Local) -> dict[str, tuple[str, bytes]]:
    """Return the files of `robot/` on the boot partition: by name their hash and content.

    Raises:
        BuildError: one that local.yaml names is not there, or is not what it should be.
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
    """Return a public key as the robot reads it: 64 hex digits.

    Raises:
        BuildError: the file is not there, or holds no public ed25519 key in PEM.
    """
    try:
        key = load_pem_public_key(path.read_bytes())
    except OSError as error:
        raise BuildError(f"local.yaml: update_key: {error}") from error
    except (ValueError, UnsupportedAlgorithm):
        key = None
    if not isinstance(key, Ed25519PublicKey):
        raise BuildError(f"local.yaml: update_key: {path} is no public ed25519 key in PEM")
    return key.public_bytes(Encoding.Raw, PublicFormat.Raw).hex()
