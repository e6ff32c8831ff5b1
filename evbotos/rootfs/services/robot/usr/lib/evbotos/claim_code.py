"""Open SSH to the owner of a machine without a fleet, who reads its claim code on the console.

The code is made anew at each start. Two SSH keys are derived from it: the machine's host key, by which the owner knows
the machine, and the only key that may log in; it may only hand over an identity.
"""

from __future__ import annotations

import base64
import ctypes
import hashlib
import os
import struct
import sys
from pathlib import Path
from typing import Final

_ED25519: Final = 1087
"""OpenSSL's identifier of the key type."""
_TYPE: Final = b"ssh-ed25519"
_SALT: Final = b"evbotos claim code 1"
_COST: Final = 1 << 14
"""Of scrypt; it takes 16 MB."""
_SEED: Final = 32
_CODE_BYTES: Final = 10
_ALLOWED: Final = (
    'command="/usr/lib/evbotos/take-identity",no-port-forwarding,no-agent-forwarding,no-X11-forwarding,no-pty'
)


def seeds_of(code: str) -> tuple[bytes, bytes]:
    """Return the private keys of the machine and of the owner, 32 bytes each."""
    letters = code.replace("-", "").encode()
    both = hashlib.scrypt(letters, salt=_SALT, n=_COST, r=8, p=1, dklen=2 * _SEED)
    return both[:_SEED], both[_SEED:]


def public_key(seed: bytes) -> bytes:
    """Return the public key of a private ed25519 key.

    Raises:
        OSError: this OpenSSL does not support ed25519.
    """
    crypto = ctypes.CDLL("libcrypto.so.3")
    new, free, get = crypto.EVP_PKEY_new_raw_private_key, crypto.EVP_PKEY_free, crypto.EVP_PKEY_get_raw_public_key
    new.restype, new.argtypes = ctypes.c_void_p, (ctypes.c_int, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_size_t)
    free.restype, free.argtypes = None, (ctypes.c_void_p,)
    get.argtypes = (ctypes.c_void_p, ctypes.c_char_p, ctypes.POINTER(ctypes.c_size_t))
    key = new(_ED25519, None, seed, len(seed))
    try:
        size, raw = ctypes.c_size_t(_SEED), ctypes.create_string_buffer(_SEED)
        if not key or get(key, raw, ctypes.byref(size)) != 1:
            raise OSError("this OpenSSL does not support ed25519")
        return raw.raw
    finally:
        free(key)


def _packed(*parts: bytes) -> bytes:
    return b"".join(struct.pack(">I", len(part)) + part for part in parts)


def main(host_key: str, authorized_keys: str) -> None:
    """Make a code, write dropbear's host key and the file of authorized keys, and print the code."""
    letters = base64.b32encode(os.urandom(_CODE_BYTES)).decode()
    code = "-".join(letters[start : start + 4] for start in range(0, len(letters), 4))
    machine, owner = seeds_of(code)
    Path(host_key).write_bytes(_packed(_TYPE, machine + public_key(machine)))
    login = base64.b64encode(_packed(_TYPE, public_key(owner))).decode()
    Path(authorized_keys).write_text(f"{_ALLOWED} {_TYPE.decode()} {login}\n")
    sys.stdout.write(code)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
