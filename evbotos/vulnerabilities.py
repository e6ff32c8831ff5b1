"""Known vulnerabilities of an image's components, from database files: Debian's security tracker and OSV.

Source: https://security-tracker.debian.org/tracker/data/json and https://ossf.github.io/osv-schema/.
"""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from packageurl import PackageURL
from packaging.utils import canonicalize_name
from packaging.version import InvalidVersion, Version

from evbotos.errors import BuildError

_UNSTABLE: Final = "sid"
"""The release whose versions backports have; Debian tracks none for them."""
_OSV_SUITES: Final = {"Debian:11": "bullseye", "Debian:12": "bookworm", "Debian:13": "trixie"}
UNIMPORTANT: Final = "unimportant"
"""Debian's word for what is no danger in its packages."""


@dataclass(frozen=True, slots=True, order=True)
class Component:
    """A package of an image.

    Attributes:
        name: of the package.
        source: the name that databases use: of Debian's source package, or of the Python package.
        version: of the source.
        suite: Debian's release; empty for a Python package.
    """

    name: str
    source: str
    version: str
    suite: str


@dataclass(frozen=True, slots=True, order=True)
class Finding:
    """A vulnerability of a component.

    Attributes:
        identifier: of the vulnerability, such as CVE-2024-1234.
        fixed: the version without it; empty if there is none yet.
        urgency: Debian's judgement, or empty.
        description: one line.
    """

    component: Component
    identifier: str
    fixed: str
    urgency: str
    description: str


def components_of(bill: Path) -> list[Component]:
    """Return the Debian and Python packages of a bill of materials.

    Raises:
        BuildError: the file is not a bill of materials of `evbotos build`.
    """
    try:
        purls = [
            PackageURL.from_string(one["purl"]) for one in json.loads(bill.read_text())["components"] if "purl" in one
        ]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BuildError(f"{bill} is not a bill of materials in CycloneDX's JSON: {error}") from None
    found = []
    for purl in purls:
        version, more = purl.version or "", dict(purl.qualifiers)
        if purl.type == "deb":
            source, _, stated = more.get("upstream", purl.name).partition("@")
            found.append(Component(purl.name, source, stated or version, more.get("distro", "")))
        elif purl.type == "pypi":
            found.append(Component(purl.name, canonicalize_name(purl.name), version, ""))
    if not any(component.suite for component in found):
        raise BuildError(f"{bill} names no Debian release: build the image anew")
    return found


def findings(components: Iterable[Component], database: Path) -> list[Finding]:
    """Return the vulnerabilities of components in a database file.

    Args:
        components: what is examined.
        database: JSON of Debian's security tracker, or of OSV as JSON or as a zip of JSON files.

    Raises:
        BuildError: the file is not such a database.
    """
    by_source: dict[tuple[str, bool], list[Component]] = {}
    for component in components:
        by_source.setdefault((component.source, bool(component.suite)), []).append(component)
    try:
        if zipfile.is_zipfile(database):
            return sorted({one for entry in _zipped(database) for one in _osv(entry, by_source)})
        content = json.loads(database.read_text())
        if isinstance(content, dict) and "affected" not in content:
            return sorted(set(_tracker(content, by_source)))
        entries = content if isinstance(content, list) else [content]
        return sorted({one for entry in entries for one in _osv(entry, by_source)})
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise BuildError(f"{database} is neither Debian's tracker nor OSV: {type(error).__name__}: {error}") from None


def _zipped(database: Path) -> Iterator[Any]:
    with zipfile.ZipFile(database) as archive:
        for name in archive.namelist():
            if name.endswith(".json"):
                yield json.loads(archive.read(name))


_BySource = dict[tuple[str, bool], list[Component]]


def _tracker(content: dict[str, Any], by_source: _BySource) -> Iterator[Finding]:
    if not content or not all(isinstance(issues, dict) for issues in content.values()):
        raise ValueError("it has no packages")
    for (source, is_debian), components in by_source.items():
        for identifier, issue in content.get(source, {}).items() if is_debian else ():
            for component in components:
                told = issue["releases"].get(_UNSTABLE if component.suite.endswith("-backports") else component.suite)
                if told is None:
                    continue
                fixed = str(told.get("fixed_version", "")) if told["status"] == "resolved" else ""
                if told["status"] == "resolved" and not is_older(component.version, fixed or "0"):
                    continue
                words = " ".join(str(issue.get("description", "")).split())
                yield Finding(component, identifier, fixed, str(told.get("urgency", "")), words)


def _osv(entry: dict[str, Any], by_source: _BySource) -> Iterator[Finding]:
    if entry.get("withdrawn"):
        return
    for affected in entry.get("affected", ()):
        package = affected.get("package", {})
        ecosystem, name = str(package.get("ecosystem", "")), str(package.get("name", ""))
        suite = _OSV_SUITES.get(ecosystem, "")
        if ecosystem != "PyPI" and not suite:
            continue
        for component in by_source.get((name if suite else canonicalize_name(name), bool(suite)), ()):
            hit, fixed = _is_affected(component, affected, is_older if suite else _is_older_python)
            if hit and component.suite == suite:
                yield Finding(
                    component, _common_name(entry), fixed, "", " ".join(str(entry.get("summary", "")).split())
                )


def _common_name(entry: dict[str, Any]) -> str:
    names = [str(entry["id"]), *map(str, entry.get("aliases", ()))]
    return next((name for name in names if name.startswith("CVE-")), names[0])


def _is_affected(component: Component, affected: dict[str, Any], older: Callable[[str, str], bool]) -> tuple[bool, str]:
    """Return whether a version is affected, and the version that is not."""
    for ranged in affected.get("ranges", ()):
        if ranged.get("type") != "ECOSYSTEM":
            continue
        is_in = False
        for event in ranged.get("events", ()):
            if "introduced" in event:
                is_in = event["introduced"] == "0" or not older(component.version, str(event["introduced"]))
            elif is_in and "fixed" in event:
                if older(component.version, str(event["fixed"])):
                    return True, str(event["fixed"])
                is_in = False
            elif is_in and "last_affected" in event:
                if not older(str(event["last_affected"]), component.version):
                    return True, ""
                is_in = False
        if is_in:
            return True, ""
    return component.version in affected.get("versions", ()), ""


def _is_older_python(one: str, other: str) -> bool:
    try:
        return Version(one) < Version(other)
    except InvalidVersion:
        return False


def is_older(one: str, other: str) -> bool:
    """Return whether a Debian version is lower than another. Source: deb-version(7)."""
    return _debian_key(one) < _debian_key(other)


def _debian_key(version: str) -> tuple[int, list[Any], list[Any]]:
    epoch, colon, rest = version.partition(":")
    if not colon:
        epoch, rest = "0", version
    upstream, dash, revision = rest.rpartition("-")
    return int(epoch), _part_key(upstream if dash else rest), _part_key(revision if dash else "0")


def _part_key(part: str) -> list[Any]:
    """Return digits as numbers, and other characters with `~` before the end, and letters before the rest."""
    key: list[Any] = []
    words = re.findall(r"(\D*)(\d*)", part)
    for word, digits in words:
        order = [-1 if char == "~" else ord(char) + (0 if char.isalpha() else 256) for char in word]
        key += [[*order, 0], int(digits or "0")]
    return key
