"""Identities: what makes one robot of a fleet out of a machine with the image that all of them have.

An identity is a small tar: the fleet file, the robot's name, certificate and key, who may log in, the key that verifies
updates, and an SSH host key, so that the first login is to the right robot. It goes onto a card with
`evbotos flash --identity`, or onto a machine without a fleet of its own by a USB stick.
"""

from __future__ import annotations

import io
import os
import shutil
import struct
import tarfile
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Final

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from eal_actors.kernel.yaml_source import load_yaml
from eal_actors.kernel.yaml_tree import texts_in
from evbotos.disk import START
from evbotos.errors import BuildError
from evbotos.hosttools import tool
from evbotos.private_keys import needed_files
from evbotos.robot_files import robots_of
from evbotos.shell import run

ENDING: Final = ".identity.tar"
HOST_KEY: Final = "host_ed25519"
_KEY_TYPE: Final = b"ssh-ed25519"
_QUIET: Final = {"MTOOLS_SKIP_CHECK": "1"}
_REQUIRED: Final = ("fleet.yaml", "name")
_END: Final = bytes(1024)
"""The end of a tar; without it, files that came after a cut are missing."""


def identity_files(fleet: Path, robot: str, access: dict[str, bytes], host_key: Ed25519PrivateKey) -> dict[str, bytes]:
    """Return the files of a robot's identity by name.

    Args:
        fleet: the fleet file; files that it names, below its folder, are included.
        robot: the robot's name.
        access: who may log in, and whose updates are accepted.
        host_key: the robot's SSH host key.

    Raises:
        BuildError: a file is missing, or must not be on a robot.
    """
    root = load_yaml(fleet).root
    security = (root.get("network") or {}).get("security") or {}
    folder = PurePosixPath(str(security.get("keys", "keys")))
    if folder.is_absolute() or ".." in folder.parts:
        raise BuildError(f"{fleet}: network.security.keys: {folder} is not below the fleet file's folder")
    keys = fleet.parent / folder
    own = [keys / name for name in ("ca.pem", f"{robot}.pem", f"{robot}.key", "revoked.txt")]
    named = [fleet.parent / value for value in texts_in(root) if _is_file_below(fleet.parent, value)]
    contents = {
        path.relative_to(fleet.parent).as_posix(): path.read_bytes() for path in (*own, *named) if path.is_file()
    }
    contents |= {"fleet.yaml": fleet.read_bytes(), "name": f"{robot}\n".encode(), **access}
    needed, _ = needed_files(contents, robot)
    missing = [path.name for path in own[:3] if path.relative_to(fleet.parent).as_posix() not in needed]
    if missing:
        raise BuildError(f"{keys} lacks {', '.join(missing)} of {robot}: eal keys robot {robot} --fleet {fleet}")
    return {**needed, HOST_KEY: dropbear_key(host_key)}


def _is_file_below(folder: Path, value: str) -> bool:
    place = PurePosixPath(value)
    return not place.is_absolute() and ".." not in place.parts and len(value) < 256 and (folder / value).is_file()


def dropbear_key(key: Ed25519PrivateKey) -> bytes:
    """Return a host key in dropbear's format: the type, then the private and the public key in one string."""
    private = key.private_bytes(Encoding.Raw, PrivateFormat.Raw, NoEncryption())
    public = key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw)
    return b"".join(struct.pack(">I", len(part)) + part for part in (_KEY_TYPE, private + public))


def host_key_in(identity: Path) -> Ed25519PrivateKey | None:
    """Return the host key of an existing identity, which a renewed one keeps; None if there is none."""
    if not identity.is_file():
        return None
    content = read_identity(identity).get(HOST_KEY, b"")
    seed = content[len(_KEY_TYPE) + 8 :][:32]
    return Ed25519PrivateKey.from_private_bytes(seed) if len(seed) == 32 else None


def write_identity(files: dict[str, bytes], out: Path) -> None:
    """Write an identity, readable for its owner only."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for name, content in sorted(files.items()):
            info = tarfile.TarInfo(name)
            info.size, info.mode = len(content), 0o600
            archive.addfile(info, io.BytesIO(content))
    part = out.with_name(f".{out.name}.part")
    part.unlink(missing_ok=True)
    with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(packed.getvalue())
    part.replace(out)


def read_identity(identity: Path) -> dict[str, bytes]:
    """Return the files of an identity by name.

    Raises:
        BuildError: the file is not an identity, or not a whole one.
    """
    try:
        if not identity.read_bytes().endswith(_END):
            raise BuildError(f"{identity} is not an identity of `evbotos provision`, or not a whole one")
        with tarfile.open(identity) as archive:
            found = {member.name: archive.extractfile(member) for member in archive if member.isfile()}
            files = {name: file.read() for name, file in found.items() if file is not None}
    except (OSError, tarfile.TarError) as error:
        raise BuildError(f"{identity} is not an identity of `evbotos provision`: {error}") from None
    unsafe = [name for name in files if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts]
    if unsafe or not set(_REQUIRED) <= set(files):
        raise BuildError(f"{identity} is not an identity of `evbotos provision`")
    return files


def has_fleet(image: Path) -> bool:
    """Return whether a disk image contains a fleet file of its own."""
    try:
        return "fleet.yaml" in run([tool("mdir"), "-b", "-i", f"{image}@@{START}", "::/robot"], env=_QUIET)
    except BuildError:
        return False


def put_identity(identity: Path, image: Path) -> str:
    """Write an identity into the boot partition of a disk image, and return the robot's name.

    Raises:
        BuildError: the image has a fleet of its own, or the identity is invalid.
    """
    files = read_identity(identity)
    if has_fleet(image):
        raise BuildError(f"{image.name} has a robot's files already: build it without `robot:` in local.yaml")
    with TemporaryDirectory() as folder:
        for name, content in files.items():
            place = Path(folder) / name
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(content)
        run(
            [tool("mcopy"), "-s", "-o", "-Q", "-i", f"{image}@@{START}", *sorted(Path(folder).iterdir()), "::/robot"],
            env=_QUIET,
        )
    return files["name"].decode().strip()


def image_with(identity: Path, image: Path, folder: Path) -> Path:
    """Return a copy of a disk image with an identity, in a folder."""
    copy = Path(shutil.copyfile(image, folder / image.name))
    put_identity(identity, copy)
    return copy


def address_hosts(fleet: Path, robot: str) -> str:
    """Return the host in a robot's address, for `known_hosts`."""
    address = str(robots_of(fleet)[robot].get("address", ""))
    return address.partition("/")[2].rpartition(":")[0].strip("[]") or robot
