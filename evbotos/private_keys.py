"""Which private keys may go onto a robot: its own, and never the authority's, under whatever name or format."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import PurePosixPath
from typing import Final

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    PublicFormat,
    load_der_private_key,
    load_pem_private_key,
    load_ssh_private_key,
)
from cryptography.x509.oid import NameOID

from evbotos.errors import BuildError

_AUTHORITY_KEY: Final = "ca.key"
_PEM_KEY: Final = re.compile(rb"-----BEGIN [A-Z ]*PRIVATE KEY-----.*?-----END [A-Z ]*PRIVATE KEY-----\n?", re.DOTALL)
_PEM_CERTIFICATE: Final = b"-----BEGIN CERTIFICATE-----"
_LOADERS: Final = (load_pem_private_key, load_ssh_private_key, load_der_private_key)
_LARGEST: Final = 1 << 16
"""No file with a key is larger."""


def needed_files(contents: Mapping[str, bytes], robot: str | None) -> tuple[dict[str, bytes], list[str]]:
    """Return the files that a robot needs, and the names of those left out: keys and certificates of others.

    Args:
        contents: files by name.
        robot: the robot's name; None if it has no certificate.

    Raises:
        BuildError: a file contains the authority's private key, or one that cannot be examined.
    """
    certificates = {name: _certificates(content) for name, content in contents.items()}
    owners = {_public(one.public_key()): one for found in certificates.values() for one in found}
    needed: dict[str, bytes] = {}
    left_out: list[str] = []
    for name, content in contents.items():
        mine = [owners[key] for key in _keys(name, content) if key in owners]
        if PurePosixPath(name).name == _AUTHORITY_KEY or any(_is_authority(one) for one in mine):
            raise BuildError(
                f"{name} is the private key of the fleet's authority, which makes keys that command every robot. "
                "Remove it from the robot's files; it stays on the machine that runs `eal keys`"
            )
        others = [one for one in (*mine, *certificates[name]) if not _is_authority(one) and _owner(one) != robot]
        if others:
            left_out.append(name)
        else:
            needed[name] = content
    return needed, sorted(left_out)


def _keys(name: str, content: bytes) -> Iterable[bytes]:
    """Return the public parts of the private keys in a file."""
    if len(content) > _LARGEST:
        return []
    found = []
    blocks = _PEM_KEY.findall(content)
    for block in blocks or [content]:
        for load in _LOADERS:
            try:
                found.append(_public(load(block, None).public_key()))
                break
            except TypeError:
                raise BuildError(f"{name} has a private key with a password, which no robot can use") from None
            except (ValueError, UnsupportedAlgorithm):
                continue
        else:
            if blocks:
                raise BuildError(f"{name} has a private key that cannot be read")
    return found


def _certificates(content: bytes) -> list[x509.Certificate]:
    if _PEM_CERTIFICATE not in content[:_LARGEST]:
        return []
    try:
        return x509.load_pem_x509_certificates(content)
    except ValueError:
        return []


def _public(key: object) -> bytes:
    encoded: bytes = key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)  # type: ignore[attr-defined]
    return encoded


def _is_authority(certificate: x509.Certificate) -> bool:
    try:
        return certificate.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    except x509.ExtensionNotFound:
        return False


def _owner(certificate: x509.Certificate) -> str:
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""
