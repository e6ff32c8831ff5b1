"""Tokens of operators: random, shown once, and kept in the fleet file as a hash that does not reveal them."""

from __future__ import annotations

import base64
import hashlib
import hmac
import secrets
from typing import Final

_COST: Final = 14  # the binary logarithm of scrypt's N. With r = 8, one hash takes 16 MiB and about 50 ms.
_SALT_BYTES: Final = 16
_TOKEN_BYTES: Final = 24


def new_token() -> str:
    """Return a random token."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


def hash_token(token: str, salt: bytes | None = None) -> str:
    """Return the hash of a token for the fleet file: `scrypt:14:`, a salt and the hash. Thread: blocks for one hash."""
    salt = secrets.token_bytes(_SALT_BYTES) if salt is None else salt
    digest = hashlib.scrypt(token.encode(), salt=salt, n=2**_COST, r=8, p=1, dklen=32)
    return f"scrypt:{_COST}:{_text(salt)}:{_text(digest)}"


def matches(token: str, kept: str) -> bool:
    """Return whether a hash of the fleet file is of this token. Thread: blocks for one hash."""
    fields = kept.split(":")
    salt = base64.urlsafe_b64decode(f"{fields[2]}==") if len(fields) == 4 else b""
    return hmac.compare_digest(hash_token(token, salt), kept)


def _text(content: bytes) -> str:
    return base64.urlsafe_b64encode(content).decode().rstrip("=")
