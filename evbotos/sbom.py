"""The bill of materials, in CycloneDX's JSON."""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Final
from urllib.parse import quote

from cyclonedx.model import HashAlgorithm, HashType
from cyclonedx.model.bom import Bom, BomMetaData
from cyclonedx.model.component import Component, ComponentType
from cyclonedx.model.license import DisjunctiveLicense, LicenseExpression
from cyclonedx.output.json import JsonV1Dot5
from cyclonedx.spdx import is_expression, is_supported_id
from packageurl import PackageURL
from packaging.utils import canonicalize_name

import eal_actors
from evbotos.licences import Origin
from evbotos.lock import Lock, LockedPackage, LockedSource, LockedWheel
from evbotos.model import Image, Platform

_LINUX: Final = Origin("linux", "", ("GPL-2.0-only WITH Linux-syscall-note",))
"""The kernel, by the file COPYING of its source."""
_OWN: Final = Origin("eal-actors", eal_actors.__version__, ("Apache-2.0",))


def bill_of_materials(lock: Lock, image: Image, platform: Platform, origins: Mapping[str, Origin]) -> str:
    """Return the bill of materials of an image.

    Args:
        lock: the image's lock.
        image: the image definition.
        platform: the board.
        origins: licences and sources by package or file.
    """
    name = f"evbotos-{lock.platform}-{lock.image}"
    bom = Bom(serial_number=uuid.uuid5(uuid.NAMESPACE_URL, f"{name}/{lock.asked}/{lock.epoch}"))
    this = Component(name=name, version=str(lock.epoch), type=ComponentType.OPERATING_SYSTEM, bom_ref=name)
    bom.metadata = BomMetaData(component=this, timestamp=datetime.fromtimestamp(lock.epoch, UTC))
    own = Component(name="eal-actors", version=eal_actors.__version__, bom_ref="eal-actors")
    own.licenses.update(_licences(_OWN))
    bom.components.add(own)
    bom.components.add(_debian(lock.kernel, _LINUX, platform))
    loaders = [package for package in lock.build_packages if package.name in platform.disk_packages]
    for package in (*lock.packages, *loaders):
        if not image.leaves_out(package.name):
            bom.components.add(_debian(package, origins.get(package.name), platform))
    wheels: tuple[LockedWheel | LockedSource, ...] = (*lock.wheels, *lock.compiled)
    for wheel in wheels:
        bom.components.add(_wheel(wheel, origins.get(canonicalize_name(wheel.name))))
    bom.register_dependency(this, bom.components)
    return JsonV1Dot5(bom).output_as_string(indent=2) + "\n"


def _licences(origin: Origin | None) -> list[DisjunctiveLicense] | list[LicenseExpression]:
    names = origin.licences if origin is not None else ()
    if len(names) == 1 and not is_supported_id(names[0]) and is_expression(names[0]):
        return [LicenseExpression(names[0])]
    return [DisjunctiveLicense(id=name) if is_supported_id(name) else DisjunctiveLicense(name=name) for name in names]


def _debian(package: LockedPackage, origin: Origin | None, platform: Platform) -> Component:
    suite = f"{platform.suite}-backports" if "~bpo" in package.version else platform.suite
    place = {"arch": platform.architecture, "distro": suite}
    upstream = {} if origin is None else {"upstream": "@".join(filter(None, (origin.source, origin.source_version)))}
    url = PackageURL("deb", "debian", package.name, package.version, {**place, **upstream})
    return _component(package, url, origin, f"deb/{package.name}")


def _wheel(wheel: LockedWheel | LockedSource, origin: Origin | None) -> Component:
    url = PackageURL("pypi", None, wheel.name, wheel.version, {"file_name": quote(wheel.file)})
    return _component(wheel, url, origin, f"pypi/{wheel.name}")


def _component(
    part: LockedPackage | LockedWheel | LockedSource, url: PackageURL, origin: Origin | None, reference: str
) -> Component:
    return Component(
        name=part.name,
        version=part.version,
        type=ComponentType.LIBRARY,
        hashes=[HashType(alg=HashAlgorithm.SHA_256, content=part.sha256)],
        purl=url,
        licenses=_licences(origin),
        bom_ref=reference,
    )
