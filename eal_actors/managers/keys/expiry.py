"""When certificates cease to be valid, read without the package `cryptography`, which robots need not have.

A warning never prevents anything: a file that cannot be read gives none here and is reported where it is used. A read
certificate is kept until its file changes, since each ping asks.
"""

from __future__ import annotations

import ssl
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from pathlib import Path
from typing import Final

from eal_actors.kernel.clock import wall_time
from eal_actors.kernel.errors import ConfigError
from eal_actors.managers.keys.certificates import AUTHORITY, certificate_file
from eal_actors.managers.keys.revocation import revoked_names
from eal_actors.managers.network_model import SecurityConfig

_SOON: Final = timedelta(days=30)
_SOON_OF_LIFETIME: Final = 5
"""A certificate with a short lifetime is reported in this last part of it only: one fifth."""

_VERSION: Final = 0xA0
_TIME_FORMATS: Final = {0x17: "%y%m%d%H%M%SZ", 0x18: "%Y%m%d%H%M%SZ"}  # UTCTime and GeneralizedTime


def validity(file: Path) -> tuple[datetime, datetime]:
    """Return when a certificate begins and ceases to be valid, in UTC; ValueError if it is none, or OSError.

    Source: RFC 5280 §4.1; ITU-T X.690 §8.1 (DER).
    """
    return _validity(file, file.stat().st_mtime_ns)


@lru_cache(maxsize=16)
def _validity(file: Path, _: int) -> tuple[datetime, datetime]:
    der = ssl.PEM_cert_to_DER_cert(file.read_text(encoding="ascii"))
    try:
        ((_, certificate),) = _items(der)
        fields = [item for item in _items(next(_items(certificate))[1]) if item[0] != _VERSION]
        begins, ends = (datetime.strptime(text.decode(), _TIME_FORMATS[tag]) for tag, text in _items(fields[3][1]))
    except (StopIteration, IndexError, KeyError) as error:
        raise ValueError(f"{file} is no certificate") from error
    return begins.replace(tzinfo=UTC), ends.replace(tzinfo=UTC)


def _items(der: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the tag and the content of each item of a DER sequence's content."""
    at = 0
    while at < len(der):
        tag, size, at = der[at], der[at + 1], at + 2
        if size & 0x80:
            octets = size & 0x7F
            size, at = int.from_bytes(der[at : at + octets]), at + octets
        yield tag, der[at : at + size]
        at += size


def expires_soon(begins: datetime, ends: datetime, now: datetime) -> bool:
    """Return whether a certificate is about to expire: within 30 days, or the last fifth of a shorter lifetime."""
    return ends - now < min(_SOON, (ends - begins) / _SOON_OF_LIFETIME)


def time_left(ends: datetime, now: datetime) -> str:
    """Return for people how long a certificate is still valid, such as `in 12 days`, `in 7 hours` or `now`."""
    left = ends - now
    if left < timedelta():
        return "now"
    return f"in {left.days} days" if left >= timedelta(days=2) else f"in {int(left.total_seconds() // 3600)} hours"


def day_or_minute(ends: datetime, now: datetime) -> str:
    """Return for people when a certificate ceases to be valid: the day, and within two days the minute, in UTC."""
    return f"{ends:%Y-%m-%d}" if ends - now >= timedelta(days=2) else f"{ends:%Y-%m-%d %H:%M} UTC"


def certificate_warnings(security: SecurityConfig | None, name: str, *, only_invalid: bool = False) -> list[str]:
    """Return warnings if this end's certificate is revoked, or it or the authority's is not valid or expires soon."""
    found: list[str] = []
    if security is None:
        return found
    with suppress(ConfigError):  # a list that cannot be read is reported when the network opens
        if name in revoked_names(security.keys):
            found.append(f"the certificate {name} is revoked: its owner needs one with another name")
    now = wall_time()
    for owner in (name, AUTHORITY):
        with suppress(OSError, ValueError):
            begins, ends = validity(certificate_file(security.keys, owner))
            command = "eal keys init --force" if owner == AUTHORITY else f"eal keys renew {owner}"
            if now < begins:
                found.append(f"the certificate {owner} is not valid before {begins:%Y-%m-%d}: correct this clock")
            elif ends <= now:
                found.append(f"the certificate {owner} has expired ({ends:%Y-%m-%d}): {command}")
            elif not only_invalid and expires_soon(begins, ends, now):
                found.append(f"the certificate {owner} expires {time_left(ends, now)} ({ends:%Y-%m-%d}): {command}")
    return found
