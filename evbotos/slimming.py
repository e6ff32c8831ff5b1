"""Shared libraries: without symbols and languages that no program reads, and without those that nothing needs."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from evbotos.errors import BuildError
from evbotos.tree import needed_libraries

_ELF: Final = b"\x7fELF"
_ICU_HEADER: Final = re.compile(rb"(?s)(..)\xda\x27.{8}CmnD")
_ICU_READ: Final = (".cnv", ".icu", ".nrm", ".spp", ".cfu")
"""The data that ICU's common part reads: tables of encodings, characters and their composition."""


@dataclass(frozen=True, slots=True)
class _Layout:
    """Where an ELF file of one word size has what its loader reads: offsets in bytes, and formats of `struct`."""

    word: str
    table: int
    entry_sizes: int
    segment_offset: int
    segment_size: int
    sections: int
    section_counts: int
    section_entry: int


_LAYOUTS: Final = {
    1: _Layout("I", 28, 42, 4, 16, 32, 46, 40),
    2: _Layout("Q", 32, 54, 8, 32, 40, 58, 64),
}

_SPARE: Final = ("libBrokenLocale", "libexpatw", "libmvec", "libpcre2-8", "libsystemd", "libcap", "libtic", "libzstd")
"""Libraries that come with packages of every image, and that no program loads by name at run time, users first."""


def strip_library(content: bytes) -> bytes:
    """Return a little-endian ELF file without what follows its segments: symbols for debuggers, and section headers.

    The dynamic loader reads segments only. Unlike binutils' `strip`, this serves each architecture.

    Raises:
        BuildError: the file is none, or a big-endian one.
    """
    layout = _LAYOUTS.get(content[4]) if content[:4] == _ELF and len(content) > 64 and content[5] == 1 else None
    if layout is None:
        raise BuildError("this is no little-endian ELF file")
    (table,) = struct.unpack_from(f"<{layout.word}", content, layout.table)
    size, count = struct.unpack_from("<HH", content, layout.entry_sizes)
    end = table + size * count
    for place in range(table, end, size):
        (offset,) = struct.unpack_from(f"<{layout.word}", content, place + layout.segment_offset)
        (length,) = struct.unpack_from(f"<{layout.word}", content, place + layout.segment_size)
        end = max(end, offset + length)
    kept = bytearray(content[:end])
    struct.pack_into(f"<{layout.word}", kept, layout.sections, 0)
    struct.pack_into("<HHH", kept, layout.section_counts, layout.section_entry, 0, 0)
    return bytes(kept)


def strip_libraries(folder: Path) -> int:
    """Strip the shared libraries of a folder, such as those of wheels; return the number of removed bytes."""
    removed = 0
    for path in sorted(folder.rglob("*.so*")):
        if path.is_symlink() or not path.is_file():
            continue
        content = path.read_bytes()
        if content[:4] == _ELF:
            stripped = strip_library(content)
            path.write_bytes(stripped)
            removed += len(content) - len(stripped)
    return removed


def without_languages(library: bytes) -> bytes:
    """Return ICU's library of data with zeros, which compress to nothing, in place of what concerns languages.

    Raises:
        BuildError: the library has no table of contents that is known here.
    """
    header = _ICU_HEADER.search(library)
    if header is None:
        raise BuildError("ICU's library has no table of contents")
    table = header.start() + struct.unpack("<H", header[1])[0]
    (count,) = struct.unpack_from("<I", library, table)
    entries = [struct.unpack_from("<II", library, table + 4 + 8 * number) for number in range(count)]
    starts = [table + start for _, start in entries]
    if starts != sorted(starts):
        raise BuildError("ICU's table of contents is not in order")
    kept = bytearray(library)
    for (name_at, _), start, end in zip(entries, starts, starts[1:], strict=False):  # how long the last is, is unknown
        name = library[table + name_at : library.index(b"\0", table + name_at)].decode("ascii")
        if not name.endswith(_ICU_READ) or "/coll/" in name:
            kept[start:end] = bytes(end - start)
    return bytes(kept)


def drop_languages(root: Path) -> None:
    """Empty ICU's data of languages in a tree without the part of ICU that sorts, formats and translates by them."""
    if any(root.glob("usr/lib/*/libicui18n.so*")):
        return
    for path in root.glob("usr/lib/*/libicudata.so.*"):
        if not path.is_symlink():
            path.write_bytes(without_languages(path.read_bytes()))


def drop_spare_libraries(root: Path) -> None:
    """Remove those of a few libraries that no program of a tree needs, and no script for its linker names."""
    needed = needed_libraries(root)
    scripts = b"".join(
        path.read_bytes()
        for path in root.glob("usr/lib/*/*.so")
        if not path.is_symlink() and path.stat().st_size < 4096
    )
    gone: set[str] = set()
    for name in _SPARE:
        files = list(root.glob(f"usr/lib/*/{name}.so*"))
        users = {user for path in files for user in needed.get(path.name, ())}
        if users <= gone and not any(path.name.encode() in scripts for path in files):
            gone |= {path.relative_to(root).as_posix() for path in files}
            for path in files:
                path.unlink()
