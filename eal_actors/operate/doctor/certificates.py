"""Checks of the certificates that this machine needs: presence, permissions, validity, authority and names."""

from __future__ import annotations

import importlib.util
import stat
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final

from eal_actors.kernel.clock import wall_time
from eal_actors.kernel.errors import ConfigError
from eal_actors.managers.fleet_model import FleetConfig, RobotConfig
from eal_actors.managers.keys.certificates import AUTHORITY, DASHBOARD, certificate_file, folder_of, key_file
from eal_actors.managers.keys.expiry import day_or_minute, expires_soon, time_left
from eal_actors.managers.keys.revocation import revoked_names
from eal_actors.managers.network_model import BEHIND_ROUTER, SecurityConfig, parse_endpoint
from eal_actors.operate.doctor.diagnostic import Diagnostic, ok, problem, warning

if TYPE_CHECKING:
    from cryptography.x509 import Certificate

_AREA: Final = "certificates"
_COPY: Final = "Make it with `eal keys` on the machine with the fleet's authority, and copy it here."


@dataclass(frozen=True, slots=True)
class RequiredCertificate:
    """A certificate that this machine needs.

    `command` renews it, such as `eal keys renew one`; `host` is the one that others connect to, None for a client.
    """

    name: str
    command: str
    host: str | None = None


_AUTHORITY: Final = RequiredCertificate(AUTHORITY, "eal keys init --force, which invalidates all other certificates")


def required_certificates(
    security: SecurityConfig | None, folder: Path, served_here: Iterable[RobotConfig]
) -> list[RequiredCertificate]:
    """Return the certificates of the robots that this machine serves, the controller's, and the dashboard's if any.

    A machine that serves robots and has no controller's certificate needs none: it does not command.
    """
    has_dashboard = certificate_file(folder, DASHBOARD).exists()
    dashboards = [RequiredCertificate(DASHBOARD, f"eal keys renew {DASHBOARD}")] if has_dashboard else []
    if security is None:
        return dashboards
    wanted = [_of_robot(robot) for robot in served_here if robot.address is not None]
    if not wanted or certificate_file(security.keys, security.controller).exists():
        wanted.insert(0, RequiredCertificate(security.controller, f"eal keys renew {security.controller}"))
    return wanted + dashboards


def _of_robot(robot: RobotConfig) -> RequiredCertificate:
    address = robot.address or BEHIND_ROUTER
    host = None if address == BEHIND_ROUTER else parse_endpoint(address).host
    return RequiredCertificate(robot.name, f"eal keys renew {robot.name}", host)


def check_certificates(config: FleetConfig, served_here: Iterable[RobotConfig]) -> Iterator[Diagnostic]:
    """Yield diagnostics of the keys of a fleet with a secured network, and of the dashboard's certificate."""
    security = config.network.security
    folder = folder_of(config)
    if security is None and not certificate_file(folder, DASHBOARD).exists():
        return
    if importlib.util.find_spec("cryptography") is None:
        advice = "pip install 'eal-actors[keys]' on this machine, then run eal doctor again."
        yield warning(_AREA, "not checked: the package cryptography is not installed", advice)
        return
    authority = _read(certificate_file(folder, AUTHORITY))
    if isinstance(authority, Diagnostic):
        yield authority
        return
    yield from judge_validity(_AUTHORITY, authority.not_valid_before_utc, authority.not_valid_after_utc, wall_time())
    for wanted in required_certificates(security, folder, served_here):
        yield from _check_one(folder, wanted, authority)


def _check_one(folder: Path, wanted: RequiredCertificate, authority: Certificate) -> Iterator[Diagnostic]:
    certificate = _read(certificate_file(folder, wanted.name))
    if isinstance(certificate, Diagnostic):
        yield certificate
        return
    before, after = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    findings = [
        *_revoked(folder, wanted.name),
        *judge_validity(wanted, before, after, wall_time()),
        *_chain(wanted.name, certificate, authority),
        *_names(wanted, certificate),
        *_key(key_file(folder, wanted.name), wanted.name, certificate),
    ]
    yield from findings
    if not findings:
        yield ok(_AREA, f"{wanted.name} is valid until {day_or_minute(after, wall_time())}")


def _revoked(folder: Path, name: str) -> Iterator[Diagnostic]:
    try:
        if name in revoked_names(folder):
            advice = "On the machine with the authority, make a certificate with another name with `eal keys`."
            yield problem(_AREA, f"{name} is revoked", advice)
    except ConfigError as error:
        yield problem(_AREA, error.message, "Copy the file from the machine with the authority.")


def judge_validity(
    wanted: RequiredCertificate, begins: datetime, ends: datetime, now: datetime
) -> Iterator[Diagnostic]:
    """Yield a diagnostic if a certificate is not valid now, or expires soon."""
    name, advice = wanted.name, f"On the machine with the authority, run: {wanted.command}"
    if now < begins:
        yield problem(_AREA, f"{name} is not valid before {begins:%Y-%m-%d}", "Correct this machine's clock.")
    elif now >= ends:
        yield problem(_AREA, f"{name} expired on {ends:%Y-%m-%d}", advice)
    elif expires_soon(begins, ends, now):
        yield warning(_AREA, f"{name} expires on {ends:%Y-%m-%d}, {time_left(ends, now)}", advice)


def judge_mode(file: Path, mode: int) -> Iterator[Diagnostic]:
    """Yield a problem if other users can read or change a private key."""
    if mode & 0o077:
        yield problem(_AREA, f"{file} has the mode {mode:o}: other users can read or change it", f"chmod 600 {file}")


def _read(file: Path) -> Certificate | Diagnostic:
    from cryptography import x509

    try:
        return x509.load_pem_x509_certificate(file.read_bytes())
    except FileNotFoundError:
        return problem(_AREA, f"{file} is missing", _COPY)
    except (OSError, ValueError) as error:
        return problem(_AREA, f"{file} cannot be read: {error}", _COPY)


def _chain(name: str, certificate: Certificate, authority: Certificate) -> Iterator[Diagnostic]:
    from cryptography.exceptions import InvalidSignature

    try:
        certificate.verify_directly_issued_by(authority)
    except (InvalidSignature, ValueError, TypeError):
        advice = "Copy ca.pem, this certificate and its key from the same folder of keys."
        yield problem(_AREA, f"{name} is not signed by the authority in ca.pem", advice)


def _names(wanted: RequiredCertificate, certificate: Certificate) -> Iterator[Diagnostic]:
    from cryptography import x509
    from cryptography.x509.oid import NameOID

    names = [str(attribute.value) for attribute in certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)]
    if names != [wanted.name]:
        issued = ", ".join(names) or "nobody"
        yield problem(_AREA, f"{wanted.name}.pem is issued to {issued}, not to {wanted.name}", _COPY)
    if wanted.host is None:
        return
    hosts: list[str] = []
    with suppress(x509.ExtensionNotFound):
        alternative = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        hosts = [str(name.value) for name in alternative]
    if wanted.host not in hosts:
        what = f"{wanted.name} has the host {wanted.host}, but its certificate is for {', '.join(hosts) or 'no host'}"
        yield problem(_AREA, what, f"eal keys robot {wanted.name} --force --host {wanted.host}")


def _key(file: Path, name: str, certificate: Certificate) -> Iterator[Diagnostic]:
    from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_private_key

    try:
        mode = stat.S_IMODE(file.stat().st_mode)
        key = load_pem_private_key(file.read_bytes(), password=None)
    except FileNotFoundError:
        yield problem(_AREA, f"{file} is missing", _COPY)
        return
    except (OSError, ValueError, TypeError) as error:
        yield problem(_AREA, f"{file} cannot be read as a private key: {error}", _COPY)
        return
    yield from judge_mode(file, mode)
    form = (Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
    if key.public_key().public_bytes(*form) != certificate.public_key().public_bytes(*form):
        yield problem(_AREA, f"{file} is not the key of {name}.pem", "Copy both from the same folder of keys.")
