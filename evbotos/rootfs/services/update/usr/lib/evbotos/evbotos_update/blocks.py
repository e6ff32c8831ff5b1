"""Digests of blocks, by which a sender finds what the robot has already.

For each block of 4096 bytes: Adler-32, which a sender can roll over every offset, and the first bytes of SHA-256. They
only save traffic; an update is verified as a whole afterwards.
"""

from __future__ import annotations

import hashlib
import struct
import zlib
from pathlib import Path
from typing import Final

BLOCK: Final = 4096
_DIGEST: Final = struct.Struct(">I8s")
_READ_BLOCKS: Final = 256


def digests(target: Path, size: int) -> bytes:
    """Return the digests of the whole blocks in the first `size` bytes of a file or device."""
    found, left = [], size // BLOCK
    with target.open("rb") as file:
        while left:
            chunk = file.read(BLOCK * min(left, _READ_BLOCKS))
            pieces = [chunk[start : start + BLOCK] for start in range(0, len(chunk) - BLOCK + 1, BLOCK)]
            found += [_DIGEST.pack(zlib.adler32(piece), hashlib.sha256(piece).digest()[:8]) for piece in pieces]
            if not pieces:
                break
            left -= len(pieces)
    return b"".join(found)
