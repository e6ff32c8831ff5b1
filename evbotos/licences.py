"""Licences and sources of the packages of an image, as their own files state them."""

from __future__ import annotations

import email
import io
import re
import tarfile
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from cyclonedx.spdx import fixup_id
from packaging.utils import parse_wheel_filename

from evbotos.hosttools import tool
from evbotos.shell import run, run_binary

_STATED: Final = re.compile(r"^License:[ \t]*(\S.*)$", re.MULTILINE)
_COMMON: Final = re.compile(r"/usr/share/common-licenses/([A-Za-z][A-Za-z0-9.-]*[A-Za-z0-9])")
_PARTS: Final = re.compile(r"\s+(?:and|or|and/or)\s+|\s*[,|]\s*(?:and\s+|or\s+)?", re.IGNORECASE)
_GNU: Final = re.compile(r"(A?L?GPL|GFDL)(?:-v?|v)(\d(?:\.\d)?)(\+?)")
_SHORT: Final = {
    "expat": "MIT",
    "isc license": "ISC",
    "psf-2": "PSF-2.0",
    "bsd-4-clause-uc": "BSD-4-Clause-UC",
    "artistic": "Artistic-1.0-Perl",
}
"""Debian's short names that differ from SPDX."""
_CLASSIFIED: Final = {
    "MIT License": "MIT",
    "BSD License": "BSD-3-Clause",
    "Apache Software License": "Apache-2.0",
    "Eclipse Public License 2.0 (EPL-2.0)": "EPL-2.0",
    "Python Software Foundation License": "PSF-2.0",
}
_CLASSIFIER: Final = "License :: OSI Approved :: "
_LONGEST: Final = 80
"""A longer value of `License` is the text of the licence."""


@dataclass(frozen=True, slots=True)
class Origin:
    """The origin of a package, as its own files state it.

    Attributes:
        source: the name of its source package.
        source_version: the version of its source package.
        licences: SPDX identifiers, or the package's own names of licences that SPDX does not list.
    """

    source: str
    source_version: str
    licences: tuple[str, ...]


def debian_origin(deb: Path) -> Origin:
    """Return the origin of a Debian package.

    Raises:
        BuildError: the package cannot be read.
    """
    fields = email.message_from_string(run([tool("dpkg-deb"), "-f", deb, "Package", "Version", "Source"]))
    name, version = str(fields["Package"]), str(fields["Version"])
    source, _, stated = str(fields.get("Source", name)).partition(" ")
    content = run_binary([tool("dpkg-deb"), "--fsys-tarfile", deb])
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        wanted = f"./usr/share/doc/{name}/copyright"
        member = next((one for one in archive if one.name == wanted), None)
        if member is not None and member.issym():  # to the package that it was built with
            member = None
        file = archive.extractfile(member) if member is not None else None
        text = file.read().decode(errors="replace") if file is not None else ""
    return Origin(source, stated.strip("()") or version, debian_licences(text))


def debian_licences(copyright_file: str) -> tuple[str, ...]:
    """Return the licences that a Debian copyright file states, or refers to if it has no machine-readable form."""
    stated = _STATED.findall(copyright_file) if copyright_file.lstrip().startswith("Format:") else []
    names = [name for line in stated for name in _PARTS.split(line.strip())] or _COMMON.findall(copyright_file)
    return _distinct(names)


def with_shared(origins: Mapping[str, Origin]) -> dict[str, Origin]:
    """Return origins, where a package without a copyright file of its own has the licences of a sibling."""
    known = {one.source: one.licences for one in origins.values() if one.licences}
    return {name: replace(one, licences=one.licences or known.get(one.source, ())) for name, one in origins.items()}


def wheel_origin(wheel: Path) -> Origin:
    """Return the origin of a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        file = next(name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        metadata = email.message_from_bytes(archive.read(file))
    named = metadata.get("License-Expression") or metadata.get("License", "")
    names = [str(named).strip()] if 0 < len(str(named).strip()) <= _LONGEST and "\n" not in str(named).strip() else []
    if not names:
        classified = (str(line).removeprefix(_CLASSIFIER) for line in metadata.get_all("Classifier", []))
        names = [_CLASSIFIED[name] for name in classified if name in _CLASSIFIED]
    parts = [name for text in names for name in _PARTS.split(text)]
    return Origin(str(metadata["Name"]), str(metadata["Version"]), _distinct(parts))


def wheel_name(wheel: Path) -> str:
    """Return the package of a wheel, in the index's form of its name."""
    return str(parse_wheel_filename(wheel.name)[0])


def _distinct(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(sorted({spdx for name in names if (spdx := _spdx(name.strip(" .()")))}))


def _spdx(name: str) -> str:
    """Return the SPDX identifier of a licence, or its name."""
    gnu = _GNU.fullmatch(name)
    if gnu is not None:
        number = gnu[2] if "." in gnu[2] else f"{gnu[2]}.0"
        return f"{gnu[1]}-{number}-{'or-later' if gnu[3] else 'only'}"
    return _SHORT.get(name.lower()) or fixup_id(name) or name
