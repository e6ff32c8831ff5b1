"""Updates: a new system for a robot's other slot, signed with the owner's key."""

from __future__ import annotations

import io
import json
import tarfile
from pathlib import Path
from typing import Final

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from evbotos.errors import UpdateError
from evbotos.hashing import file_sha256
from evbotos.verity import Verity

_PARTS: Final = {"kernel": "kernel", "root": "root.squashfs"}
"""The members of an update in order, with their source files."""


def write_update(built: Path, key: Path, out: Path) -> dict[str, object]:
    """Write the update of a built image, reproducibly.

    Args:
        built: the output folder of the build.
        key: the owner's private key (ed25519, PEM, no password).
        out: the archive.

    Returns:
        The signed manifest: platform, image, version, release, root hash, and size and hash of each part.

    Raises:
        UpdateError: the key is missing or invalid.
    """
    signer = _private_key(key)
    report = json.loads((built / "manifest.json").read_text())
    parts = {part: built / name for part, name in _PARTS.items()}
    signed = {
        "platform": report["platform"],
        "image": report["image"],
        "version": f"{report['eal_actors']} of {report['epoch']}",
        "release": report["release"],
        "verity": Verity(**report["verity"]).hash_file(),
        **{part: {"size": path.stat().st_size, "sha256": file_sha256(path)} for part, path in parts.items()},
    }
    message = json.dumps(signed).encode()
    with tarfile.open(out, "w", format=tarfile.USTAR_FORMAT) as archive:
        for name, content in (("manifest.json", message), ("manifest.sig", signer.sign(message))):
            archive.addfile(_member(name, len(content), report["epoch"]), io.BytesIO(content))
        for part, path in parts.items():
            with path.open("rb") as file:
                archive.addfile(_member(part, path.stat().st_size, report["epoch"]), file)
    return signed


def _member(name: str, size: int, epoch: int) -> tarfile.TarInfo:
    info = tarfile.TarInfo(name)
    info.size, info.mtime = size, epoch
    return info


def _private_key(path: Path) -> Ed25519PrivateKey:
    try:
        key = load_pem_private_key(path.read_bytes(), password=None)
    except OSError as error:
        raise UpdateError(f"{path}: {error.strerror}") from error
    except (TypeError, ValueError, UnsupportedAlgorithm):
        key = None  # with a password, or not a key
    if not isinstance(key, Ed25519PrivateKey):
        raise UpdateError(
            f"{path} is not a private ed25519 key in PEM without a password: openssl genpkey -algorithm ed25519"
        )
    return key
