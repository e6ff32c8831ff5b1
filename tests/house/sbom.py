"""Write the bill of materials of a wheel in CycloneDX's JSON: `python -m tests.house.sbom WHEEL FILE`; `make sbom`.

Versions and hashes are those of `.ci/lock.txt`; who needs what is read from the metadata of the installed packages.
What only an extra needs is marked as optional.
"""

from __future__ import annotations

import hashlib
import re
import sys
import uuid
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass, field
from email.parser import HeaderParser
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path
from typing import Final

from cyclonedx.model import HashAlgorithm, HashType
from cyclonedx.model.bom import Bom, BomMetaData
from cyclonedx.model.component import Component, ComponentScope, ComponentType
from cyclonedx.model.license import LicenseExpression
from cyclonedx.output.json import JsonV1Dot6
from packageurl import PackageURL
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

LOCK: Final = Path(__file__).parents[2] / ".ci" / "lock.txt"
_ENTRY: Final = re.compile(r"^([a-z0-9][\w.-]*)==([^\s;]+)", re.MULTILINE)


@dataclass
class LockedPackage:
    """An entry of the lock: one version of a package, and the SHA-256 hashes of its files."""

    version: str
    hashes: list[str] = field(default_factory=list)


def read_lock(text: str) -> dict[str, LockedPackage]:
    """Return the entries of a lock by name."""
    packages: dict[str, LockedPackage] = {}
    for entry in re.split(r"\n(?=[a-z0-9])", text):
        match = _ENTRY.match(entry)
        if match is not None:
            found = packages.setdefault(canonicalize_name(match[1]), LockedPackage(match[2]))
            found.hashes += re.findall(r"--hash=sha256:([0-9a-f]{64})\b", entry)
    return packages


def _needed(requirements: Iterable[str], extras: Iterable[str]) -> dict[str, set[str]]:
    """Return the packages that requirements name in this environment, and the extras of each."""
    found: dict[str, set[str]] = {}
    for text in requirements:
        requirement = Requirement(text)
        marker = requirement.marker
        if marker is None or any(marker.evaluate({"extra": extra}) for extra in ("", *extras)):
            found.setdefault(canonicalize_name(requirement.name), set()).update(requirement.extras)
    return found


def _graph(roots: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return what each package needs, from the roots on."""
    graph: dict[str, set[str]] = {}
    waiting = list(roots.items())
    while waiting:
        name, extras = waiting.pop()
        if name in graph:
            continue
        try:
            needed = _needed(requires(name) or (), extras)
        except PackageNotFoundError:  # of another platform
            needed = {}
        graph[name] = set(needed)
        waiting += needed.items()
    return graph


def bill_of_materials(wheel: Path, lock: dict[str, LockedPackage]) -> str:
    """Return the bill of materials of a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        (place,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        metadata = HeaderParser().parsestr(archive.read(place).decode())
    digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
    requirements, extras = metadata.get_all("Requires-Dist", []), metadata.get_all("Provides-Extra", [])
    required = _graph(_needed(requirements, ()))
    everything = {**_graph(_needed(requirements, extras)), **required}
    this = Component(
        name=metadata["Name"],
        version=metadata["Version"],
        type=ComponentType.FRAMEWORK,
        licenses=[LicenseExpression(metadata["License-Expression"])],
        hashes=[HashType(alg=HashAlgorithm.SHA_256, content=digest)],
        purl=PackageURL("pypi", None, metadata["Name"], metadata["Version"], {"file_name": wheel.name}),
        bom_ref="this",
    )
    bom = Bom(serial_number=uuid.uuid5(uuid.NAMESPACE_URL, digest), metadata=BomMetaData(component=this))
    parts = {
        name: Component(
            name=name,
            version=lock[name].version,
            type=ComponentType.LIBRARY,
            scope=ComponentScope.REQUIRED if name in required else ComponentScope.OPTIONAL,
            purl=PackageURL("pypi", None, name, lock[name].version),
            bom_ref=f"pypi/{name}",
        )
        for name in everything
        if name in lock
    }
    for name, part in parts.items():
        bom.components.add(part)
        bom.register_dependency(part, [parts[other] for other in everything[name] if other in parts])
    bom.register_dependency(this, [parts[name] for name in _needed(requirements, extras) if name in parts])
    return JsonV1Dot6(bom).output_as_string(indent=2) + "\n"


if __name__ == "__main__":
    Path(sys.argv[2]).write_text(bill_of_materials(Path(sys.argv[1]), read_lock(LOCK.read_text())), encoding="utf-8")
