"""The bill of materials, in CycloneDX's JSON."""

from __future__ import annotations

import uuid
from datetime import UTC, datetime
from urllib.parse import quote

from cyclonedx.model import HashAlgorithm, HashType
from cyclonedx.model.bom import Bom, BomMetaData
from cyclonedx.model.component import Component, ComponentType
from cyclonedx.output.json import JsonV1Dot5
from packageurl import PackageURL

import eal_actors
from evbotos.lock import Lock, LockedPackage, LockedSource, LockedWheel


def bill_of_materials(lock: Lock, left_out: set[str], on_disk: set[str], architecture: str) -> str:
    """Return the bill of materials of an image.

    Args:
        lock: the image's lock.
        left_out: packages that are not unpacked.
        on_disk: packages with boot files, such as U-Boot.
        architecture: Debian's name of the architecture.
    """
    name = f"evbotos-{lock.platform}-{lock.image}"
    bom = Bom(serial_number=uuid.uuid5(uuid.NAMESPACE_URL, f"{name}/{lock.asked}/{lock.epoch}"))
    this = Component(name=name, version=str(lock.epoch), type=ComponentType.OPERATING_SYSTEM, bom_ref=name)
    bom.metadata = BomMetaData(component=this, timestamp=datetime.fromtimestamp(lock.epoch, UTC))
    bom.components.add(Component(name="eal-actors", version=eal_actors.__version__, bom_ref="eal-actors"))
    loaders = [package for package in lock.build_packages if package.name in on_disk]
    for package in (lock.kernel, *lock.packages, *loaders):
        if package.name not in left_out:
            bom.components.add(_debian(package, architecture))
    for wheel in lock.wheels:
        bom.components.add(_wheel(wheel))
    for source in lock.compiled:
        bom.components.add(_wheel(source))
    bom.register_dependency(this, bom.components)
    return JsonV1Dot5(bom).output_as_string(indent=2) + "\n"


def _debian(package: LockedPackage, architecture: str) -> Component:
    return Component(
        name=package.name,
        version=package.version,
        type=ComponentType.LIBRARY,
        hashes=[HashType(alg=HashAlgorithm.SHA_256, content=package.sha256)],
        purl=PackageURL("deb", "debian", package.name, package.version, {"arch": architecture}),
        bom_ref=f"deb/{package.name}",
    )


def _wheel(wheel: LockedWheel | LockedSource) -> Component:
    return Component(
        name=wheel.name,
        version=wheel.version,
        type=ComponentType.LIBRARY,
        hashes=[HashType(alg=HashAlgorithm.SHA_256, content=wheel.sha256)],
        purl=PackageURL("pypi", None, wheel.name, wheel.version, {"file_name": quote(wheel.file)}),
        bom_ref=f"pypi/{wheel.name}",
    )
