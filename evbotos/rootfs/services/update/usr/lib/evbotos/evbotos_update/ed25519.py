"""Verification of ed25519 signatures with the OpenSSL of Python's `ssl`; a library for it would take 7 MB."""

from __future__ import annotations

import ctypes
from typing import Final

_ED25519: Final = 1087
"""OpenSSL's identifier of the key type."""
_POINTER: Final = ctypes.c_void_p
_FUNCTIONS: Final[dict[str, tuple[object, tuple[object, ...]]]] = {
    "EVP_PKEY_new_raw_public_key": (_POINTER, (ctypes.c_int, _POINTER, ctypes.c_char_p, ctypes.c_size_t)),
    "EVP_PKEY_free": (None, (_POINTER,)),
    "EVP_MD_CTX_new": (_POINTER, ()),
    "EVP_MD_CTX_free": (None, (_POINTER,)),
    "EVP_DigestVerifyInit": (ctypes.c_int, (_POINTER,) * 5),
    "EVP_DigestVerify": (
        ctypes.c_int,
        (_POINTER, ctypes.c_char_p, ctypes.c_size_t, ctypes.c_char_p, ctypes.c_size_t),
    ),
}
"""Result and arguments of each function, as OpenSSL's manual pages declare them."""
_KEY_BYTES: Final = 32
_SIGNATURE_BYTES: Final = 64


def verify(public_key: bytes, signature: bytes, message: bytes) -> bool:
    """Return whether a signature is valid for a message.

    Raises:
        ValueError: the key is not an ed25519 key.
        OSError: this OpenSSL does not support ed25519.
    """
    if len(public_key) != _KEY_BYTES:
        raise ValueError(f"an ed25519 key has {_KEY_BYTES} bytes, not {len(public_key)}")
    crypto = _library()
    key = crypto.EVP_PKEY_new_raw_public_key(_ED25519, None, public_key, len(public_key))
    context = crypto.EVP_MD_CTX_new()
    try:
        if not key or not context or crypto.EVP_DigestVerifyInit(context, None, None, None, key) != 1:
            raise OSError("this OpenSSL does not support ed25519")
        valid = crypto.EVP_DigestVerify(context, signature, len(signature), message, len(message))
        return len(signature) == _SIGNATURE_BYTES and valid == 1
    finally:
        crypto.EVP_MD_CTX_free(context)
        crypto.EVP_PKEY_free(key)


def _library() -> ctypes.CDLL:
    crypto = ctypes.CDLL("libcrypto.so.3")
    for name, (result, arguments) in _FUNCTIONS.items():
        function = getattr(crypto, name)
        function.restype, function.argtypes = result, arguments
    return crypto
