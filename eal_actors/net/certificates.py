"""The certificates of a fleet: an authority of its own, and one certificate for each robot, controller and router.

A folder of keys holds `ca.pem` and `ca.key`, and `<name>.pem` and `<name>.key` for each certificate. A robot needs
`ca.pem` and its own two files; `ca.key`, which makes new certificates, stays with whoever runs `eal keys`.
"""

from __future__ import annotations

import contextlib
import ipaddress
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Final

from eal_actors.kernel.clock import wall_time
from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.strict_model import NAME_PATTERN

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey

AUTHORITY: Final = "ca"
"""Name of the authority's files."""

_AUTHORITY_VALID: Final = timedelta(days=3650)
_VALID: Final = timedelta(days=825)
_CLOCKS_MAY_DIFFER_BY: Final = timedelta(days=1)
_MAX_NAME: Final = 64  # a common name's limit in X.509


@dataclass(frozen=True, slots=True, order=True)
class Certificate:
    """What a certificate says.

    Attributes:
        name: whom it is for.
        hosts: names and addresses at which its owner may be reached; empty for one that only dials out.
        expires: when it ends, in UTC.
        file: where it is.
    """

    name: str
    hosts: tuple[str, ...]
    expires: datetime
    file: Path

    @property
    def days_left(self) -> int:
        """Whole days until it expires; negative once it has."""
        return (self.expires - wall_time()).days


def certificate_file(folder: Path, name: str) -> Path:
    """Return where the certificate of a name is."""
    return folder / f"{name}.pem"


def key_file(folder: Path, name: str) -> Path:
    """Return where the private key of a name is."""
    return folder / f"{name}.key"


def make_authority(folder: Path, fleet: str, *, force: bool = False) -> Certificate:
    """Make the authority of a fleet, which all its certificates are signed by.

    Args:
        folder: where its files go; made, closed to others, if it is not there.
        fleet: name of the fleet.
        force: replace an authority that is there, which makes all its certificates worthless.

    Raises:
        ConfigError: there is one already, the files cannot be written, or `cryptography` is not installed.
    """
    _require_cryptography()
    from cryptography import x509

    subject = _subject(f"{fleet} fleet authority"[:_MAX_NAME])
    key = _new_key()
    builder = (
        _builder(subject, subject, key, _AUTHORITY_VALID)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_key_usage(signs_certificates=True), critical=True)
    )
    return _write(folder, AUTHORITY, _signed(builder, key), key, force=force)


def make_certificate(folder: Path, name: str, hosts: Iterable[str] = (), *, force: bool = False) -> Certificate:
    """Make a certificate, good for dialling and for being dialled at the hosts.

    Args:
        folder: where the authority is, and the files go.
        name: whom it is for; access control goes by it.
        hosts: names and addresses at which it is reached.
        force: replace a certificate that is there.

    Raises:
        ConfigError: the name cannot be used, there is one already, the authority is missing or unreadable, the files
            cannot be written, or `cryptography` is not installed.
    """
    _require_cryptography()
    if not re.fullmatch(NAME_PATTERN, name) or len(name) > _MAX_NAME or name.lower() == AUTHORITY:
        rule = f"a letter, then letters, digits, '_', '.' or '-', at most {_MAX_NAME} in all, and not '{AUTHORITY}'"
        raise _refused(name, f"cannot be the name of a certificate, which is {rule}")
    from cryptography import x509
    from cryptography.x509.oid import ExtendedKeyUsageOID

    authority, authority_key = _load_authority(folder)
    key = _new_key()
    usages = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH])
    builder = (
        _builder(_subject(name), authority.subject, key, _VALID)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_key_usage(signs_certificates=False), critical=True)
        .add_extension(usages, critical=False)
    )
    names = [_general_name(host) for host in dict.fromkeys(hosts)]
    if names:
        builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
    return _write(folder, name, _signed(builder, authority_key), key, force=force)


def list_certificates(folder: Path) -> list[Certificate]:
    """Return the certificates of a folder, the authority first, then by name.

    Raises:
        ConfigError: there is no such folder, a file is no certificate, or `cryptography` is not installed.
    """
    _require_cryptography()
    if not folder.is_dir():
        raise _refused(str(folder), "no such folder; `eal keys init` makes it")
    found = [_described(_read_certificate(file), file) for file in folder.glob("*.pem")]
    return sorted(found, key=lambda certificate: (certificate.name != AUTHORITY, certificate.name))


def _require_cryptography() -> None:
    try:
        import cryptography  # noqa: F401
    except ImportError:
        raise _refused("eal keys", "needs the package cryptography: pip install 'eal-actors[keys]'") from None


def _new_key() -> EllipticCurvePrivateKey:
    from cryptography.hazmat.primitives.asymmetric import ec

    return ec.generate_private_key(ec.SECP256R1())


def _subject(name: str) -> x509.Name:
    from cryptography import x509
    from cryptography.x509.oid import NameOID

    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _general_name(host: str) -> x509.GeneralName:
    from cryptography import x509

    with contextlib.suppress(ValueError):
        return x509.IPAddress(ipaddress.ip_address(host))
    return x509.DNSName(host)


def _key_usage(*, signs_certificates: bool) -> x509.KeyUsage:
    from cryptography import x509

    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        encipher_only=False,
        decipher_only=False,
    )


def _builder(
    subject: x509.Name, issuer: x509.Name, key: EllipticCurvePrivateKey, valid: timedelta
) -> x509.CertificateBuilder:
    from cryptography import x509

    now = wall_time()
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _CLOCKS_MAY_DIFFER_BY)
        .not_valid_after(now + valid)
    )


def _signed(builder: x509.CertificateBuilder, key: EllipticCurvePrivateKey) -> x509.Certificate:
    from cryptography.hazmat.primitives import hashes

    return builder.sign(key, hashes.SHA256())


def _load_authority(folder: Path) -> tuple[x509.Certificate, EllipticCurvePrivateKey]:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    file = key_file(folder, AUTHORITY)
    try:
        key = load_pem_private_key(file.read_bytes(), password=None)
    except FileNotFoundError:
        raise _refused(str(file), "is missing; `eal keys init` makes the fleet's authority") from None
    except (OSError, ValueError, TypeError) as error:
        raise _refused(str(file), f"cannot be read as a private key: {error}") from error
    if not isinstance(key, EllipticCurvePrivateKey):
        raise _refused(str(file), "is not a key that `eal keys init` made")
    return _read_certificate(certificate_file(folder, AUTHORITY)), key


def _read_certificate(file: Path) -> x509.Certificate:
    from cryptography import x509

    try:
        return x509.load_pem_x509_certificate(file.read_bytes())
    except (OSError, ValueError) as error:
        raise _refused(str(file), f"cannot be read as a certificate: {error}") from error


def _write(
    folder: Path, name: str, certificate: x509.Certificate, key: EllipticCurvePrivateKey, *, force: bool
) -> Certificate:
    """Write a certificate and its key, the key first and readable for its owner alone."""
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    file, secret = certificate_file(folder, name), key_file(folder, name)
    there = [str(path) for path in (secret, file) if path.exists()]
    if there and not force:
        raise _refused(there[0], "is there already; --force replaces it")
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        _replace(secret, key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()), 0o600)
        _replace(file, certificate.public_bytes(Encoding.PEM), 0o644)
    except OSError as error:
        raise _refused(str(folder), f"cannot be written: {error.strerror}") from error
    return _described(certificate, file)


def _replace(file: Path, content: bytes, mode: int) -> None:
    """Write a file as a whole or not at all, never readable for more people than `mode` says."""
    new = file.with_name(f".{file.name}.new")
    new.unlink(missing_ok=True)
    with os.fdopen(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as stream:
        stream.write(content)
    new.replace(file)


def _described(certificate: x509.Certificate, file: Path) -> Certificate:
    from cryptography import x509

    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        hosts: tuple[str, ...] = ()
    else:
        hosts = tuple(str(name.value) for name in names)
    return Certificate(file.stem, hosts, certificate.not_valid_after_utc, file)


def _refused(what: str, why: str) -> ConfigError:
    return ConfigError([Problem(what, 0, 0, "", why)])
