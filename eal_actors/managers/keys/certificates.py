"""The certificates of a fleet: an authority of its own, and one certificate for each robot, controller and router.

A folder of keys contains `ca.pem` and `ca.key`, and `<name>.pem` and `<name>.key` for each certificate. A robot needs
`ca.pem` and its own two files. `ca.key` signs new certificates and stays on the machine that runs `eal keys`.
"""

from __future__ import annotations

import contextlib
import ipaddress
import os
import re
import ssl
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from eal_actors.kernel.clock import wall_time
from eal_actors.kernel.errors import ConfigError, Problem, file_error
from eal_actors.kernel.strict_model import NAME_PATTERN
from eal_actors.managers.fleet_model import FleetConfig

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey

AUTHORITY: Final = "ca"
"""Name of the authority's files."""

DASHBOARD: Final = "dashboard"
"""Name of the dashboard's files. Its certificate has no role, so it grants nothing on robots."""
DEFAULT_FOLDER: Final = "keys"
"""Folder of a fleet's keys, beside its file, where the fleet names no other."""

_AUTHORITY_VALID: Final = timedelta(days=3650)
VALID: Final = timedelta(days=825)
"""Default lifetime of a certificate."""
_PASS_VALID: Final = timedelta(hours=1)
_CLOCKS_MAY_DIFFER_BY: Final = timedelta(days=1)
_BACKDATED: Final = 0.25  # of a lifetime of less than four days
_NO_CHECK_TIME: Final = 0x200000
"""OpenSSL's X509_V_FLAG_NO_CHECK_TIME, which the module ssl does not name."""
_MAX_NAME: Final = 64  # a common name's limit in X.509


@dataclass(frozen=True, slots=True, order=True)
class Certificate:
    """Content of a certificate, whose validity begins and expires at times in UTC.

    `hosts` are host names and addresses of its owner; none for an owner that only dials out.
    """

    name: str
    hosts: tuple[str, ...]
    begins: datetime
    expires: datetime
    file: Path

    @property
    def lifetime(self) -> timedelta:
        """The time from when it was made until it expires."""
        span = self.expires - self.begins
        return max(span - _CLOCKS_MAY_DIFFER_BY, span / (1 + _BACKDATED))

    @property
    def days_left(self) -> int:
        """Whole days until it expires; negative once it has."""
        return (self.expires - wall_time()).days


def folder_of(fleet: FleetConfig) -> Path:
    """Return the folder of a fleet's keys."""
    security = fleet.network.security
    return fleet.source.parent / DEFAULT_FOLDER if security is None else security.keys


def certificate_file(folder: Path, name: str) -> Path:
    """Return the path of a certificate."""
    return folder / f"{name}.pem"


def key_file(folder: Path, name: str) -> Path:
    """Return the path of a private key."""
    return folder / f"{name}.key"


def files_of(folder: Path, name: str) -> tuple[Path, Path, Path]:
    """Return the files that an end needs: the authority's certificate, its own, and its key."""
    return certificate_file(folder, AUTHORITY), certificate_file(folder, name), key_file(folder, name)


def check_keys(folder: Path, name: str) -> None:
    """Raise ConfigError if a certificate of this name, its key or the authority's certificate cannot be used."""
    authority, certificate, key = files = files_of(folder, name)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    problems = [problem for file in files for problem in _try(file, file.read_bytes)]
    if not problems:
        load = partial(context.load_cert_chain, certificate, key, password=b"")  # an encrypted key must not ask for it
        problems += _try(authority, partial(context.load_verify_locations, authority))
        problems += _try(key, load, f"does not fit {certificate.name}, or one of both is damaged")
    if not problems:
        problems += _try(certificate, partial(_verify, context, authority), f"is not signed by {authority.name}")
    if problems:
        raise ConfigError(problems)


def _verify(owner: ssl.SSLContext, authority: Path) -> None:
    """Raise SSLError unless an authority has signed an owner's certificate, by a handshake within this process.

    Robots do not have the package cryptography. Dates are not checked: this machine's clock may still be wrong.
    """
    other = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    other.check_hostname = False  # controllers have no hosts
    other.verify_flags |= _NO_CHECK_TIME
    other.load_verify_locations(authority)
    asks, answers = ssl.MemoryBIO(), ssl.MemoryBIO()
    asking, answering = other.wrap_bio(answers, asks), owner.wrap_bio(asks, answers, server_side=True)
    for end in (asking, answering, asking):
        with contextlib.suppress(ssl.SSLWantReadError):
            end.do_handshake()


def _try(file: Path, use: Callable[[], object], wrong: str = "is damaged") -> Iterator[Problem]:
    """Yield a problem if a file of keys cannot be used."""
    copy = "make it with `eal keys` on the machine with the fleet's authority, then copy it here"
    try:
        use()
    except FileNotFoundError:
        yield Problem(str(file), 0, 0, "", f"is missing; {copy}")
    except ssl.SSLError:
        yield Problem(str(file), 0, 0, "", f"{wrong}; {copy}")
    except OSError as error:
        yield Problem(str(file), 0, 0, "", f"cannot be read: {error.strerror}")


def make_authority(folder: Path, fleet: str, *, force: bool = False) -> Certificate:
    """Create the authority of a fleet, which signs all its certificates.

    The folder of the keys is created, readable for its owner only, if it is missing. `force` replaces an existing
    authority, which invalidates all its certificates. Raises ConfigError if an authority exists, the files cannot be
    written, or `cryptography` is not installed.
    """
    _require_cryptography()
    return _issue(None, folder, AUTHORITY, f"{fleet} fleet authority"[:_MAX_NAME], (), _AUTHORITY_VALID, force=force)


def make_certificate(
    folder: Path, name: str, hosts: Iterable[str] = (), *, valid: timedelta = VALID, force: bool = False
) -> Certificate:
    """Create a certificate, valid for dialling out and for being dialled at the hosts, from now on for a lifetime.

    The folder has the authority. Access control uses the name. `force` replaces an existing certificate. Raises
    ConfigError if the name is invalid, the certificate exists, the authority is missing or unreadable, the files cannot
    be written, or `cryptography` is not installed.
    """
    _require_cryptography()
    if not re.fullmatch(NAME_PATTERN, name) or len(name) > _MAX_NAME or name.lower() == AUTHORITY:
        words = "a letter (A-Z, a-z), then letters, digits, '_', '.' or '-'"
        rule = f"{words}, at most {_MAX_NAME} in all, and not '{AUTHORITY}'"
        raise file_error(name, f"cannot be the name of a certificate, which is {rule}")
    return _issue(_load_authority(folder), folder, name, name, hosts, valid, force=force)


def renew_certificate(folder: Path, name: str, valid: timedelta | None = None) -> Certificate:
    """Replace a certificate and its key by new ones for the same hosts.

    It is valid from now on for the given lifetime, for that of the present one if None. Raises ConfigError if there is
    no such certificate, or as make_certificate.
    """
    _require_cryptography()
    file = certificate_file(folder, name)
    present = _summary(_read_certificate(file), file)
    return make_certificate(folder, name, present.hosts, valid=valid or present.lifetime, force=True)


def make_pass(folder: Path, into: Path, name: str) -> None:
    """Create a certificate of a reserved name for one hour, in another folder, with a copy of the authority's.

    Raises as make_certificate.
    """
    _require_cryptography()
    _issue(_load_authority(folder), into, name, name, (), _PASS_VALID, force=True)
    write_file(certificate_file(into, AUTHORITY), certificate_file(folder, AUTHORITY).read_bytes(), 0o644)


def _issue(
    authority: tuple[x509.Certificate, EllipticCurvePrivateKey] | None,
    folder: Path,
    name: str,
    common_name: str,
    hosts: Iterable[str],
    valid: timedelta,
    *,
    force: bool,
) -> Certificate:
    """Write a new key and its certificate, signed by the authority; it is an authority's own if there is none."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

    is_authority = authority is None
    key, now = ec.generate_private_key(ec.SECP256R1()), wall_time()
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])
    issuer, signing_key = (subject, key) if authority is None else (authority[0].subject, authority[1])
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - min(_CLOCKS_MAY_DIFFER_BY, valid * _BACKDATED))
        .not_valid_after(now + valid)
        .add_extension(x509.BasicConstraints(ca=is_authority, path_length=0 if is_authority else None), critical=True)
        .add_extension(_key_usage(signs_certificates=is_authority), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(signing_key.public_key()), critical=False)
    )
    if not is_authority:
        usages = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH])
        builder = builder.add_extension(usages, critical=False)
    names = [_general_name(host) for host in dict.fromkeys(hosts)]
    if names:
        builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
    return _write(folder, name, builder.sign(signing_key, hashes.SHA256()), key, force=force)


def list_certificates(folder: Path) -> list[Certificate]:
    """Return the certificates of a folder, the authority first, then by name; ConfigError if one cannot be read."""
    _require_cryptography()
    if not folder.is_dir():
        raise file_error(str(folder), "no such folder; `eal keys init` makes it")
    found = [_summary(_read_certificate(file), file) for file in folder.glob("*.pem")]
    return sorted(found, key=lambda certificate: (certificate.name != AUTHORITY, certificate.name))


def _require_cryptography() -> None:
    try:
        import cryptography  # noqa: F401
    except ImportError:
        raise file_error("eal keys", "needs the package cryptography: pip install 'eal-actors[keys]'") from None


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


def _load_authority(folder: Path) -> tuple[x509.Certificate, EllipticCurvePrivateKey]:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    file = key_file(folder, AUTHORITY)
    try:
        key = load_pem_private_key(file.read_bytes(), password=None)
    except FileNotFoundError:
        raise file_error(str(file), "is missing; `eal keys init` makes the fleet's authority") from None
    except (OSError, ValueError, TypeError) as error:
        raise file_error(str(file), f"cannot be read as a private key: {error}") from error
    if not isinstance(key, EllipticCurvePrivateKey):
        raise file_error(str(file), "is not a key that `eal keys init` made")
    return _read_certificate(certificate_file(folder, AUTHORITY)), key


def _read_certificate(file: Path) -> x509.Certificate:
    from cryptography import x509

    try:
        return x509.load_pem_x509_certificate(file.read_bytes())
    except (OSError, ValueError) as error:
        raise file_error(str(file), f"cannot be read as a certificate: {error}") from error


def _write(
    folder: Path, name: str, certificate: x509.Certificate, key: EllipticCurvePrivateKey, *, force: bool
) -> Certificate:
    """Write a certificate and its key; the key first, readable for its owner only."""
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    file, secret = certificate_file(folder, name), key_file(folder, name)
    existing = [str(path) for path in (secret, file) if path.exists()]
    if existing and not force:
        raise file_error(existing[0], "is there already; --force replaces it")
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        write_file(secret, key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()), 0o600)
        write_file(file, certificate.public_bytes(Encoding.PEM), 0o644)
    except OSError as error:
        raise file_error(str(folder), f"cannot be written: {error.strerror}") from error
    return _summary(certificate, file)


def write_file(file: Path, content: bytes, mode: int) -> None:
    """Write a file atomically; at no time does it have wider permissions than `mode`."""
    new = file.with_name(f".{file.name}.new")
    new.unlink(missing_ok=True)
    with os.fdopen(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as stream:
        stream.write(content)
    new.replace(file)


def _summary(certificate: x509.Certificate, file: Path) -> Certificate:
    from cryptography import x509

    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        hosts: tuple[str, ...] = ()
    else:
        hosts = tuple(str(name.value) for name in names)
    return Certificate(file.stem, hosts, certificate.not_valid_before_utc, certificate.not_valid_after_utc, file)
