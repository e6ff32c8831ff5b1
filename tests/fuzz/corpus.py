"""The seeds of every target: what is kept in `corpus/<target>`, and files that the project ships."""

from __future__ import annotations

import hashlib
import random
from collections.abc import Callable
from pathlib import Path
from typing import Final

from tests.fuzz.decoders import DECODERS
from tests.fuzz.loaders import LOADERS, ROOT, SHIPPED

CORPUS: Final = Path(__file__).parent / "corpus"
TARGETS: Final[dict[str, Callable[[bytes], None]]] = {**DECODERS, **LOADERS}
MOST_BYTES: Final = 8192
_TELLING: Final = (
    b"\x00",
    b"\xff",
    b"\x7f",
    b"\x80",
    b"\n",
    b"~",
    b"}",
    b"$",
    b"*",
    b"&a ",
    b"*a",
    b"${",
    b": ",
    b"- ",
)


def kept(target: str) -> list[Path]:
    """Return the files that are kept for a target: seeds, and everything that was ever a finding."""
    return sorted((CORPUS / target).iterdir())


def seeds(target: str) -> list[bytes]:
    """Return what to begin with."""
    shipped = sorted(ROOT.glob(SHIPPED[target])) if target in SHIPPED else []
    return [path.read_bytes() for path in [*kept(target), *shipped]]


def keep(target: str, data: bytes) -> Path:
    """Keep a finding for ever."""
    path = CORPUS / target / f"finding-{hashlib.sha256(data).hexdigest()[:12]}"
    path.write_bytes(data)
    return path


def mutated(begin: bytes, other: bytes, chance: random.Random) -> bytes:
    """Return bytes with a few changes: flipped, cut out, doubled, put in, or joined with others."""
    data = bytearray(begin)
    for _ in range(chance.randint(1, 6)):
        at = chance.randint(0, len(data))
        length = chance.randint(1, 16)
        way = chance.randint(0, 5)
        if way == 0 and at < len(data):
            data[at] ^= 1 << chance.randint(0, 7)
        elif way == 1:
            del data[at : at + length]
        elif way == 2:
            data[at:at] = data[at : at + length] * chance.randint(1, 8)
        elif way == 3:
            data[at:at] = chance.choice(_TELLING)
        elif way == 4:
            data[at : at + length] = bytes(chance.randint(0, 255) for _ in range(length))
        else:
            data[at:] = other[chance.randint(0, len(other)) :]
    return bytes(data[:MOST_BYTES])
