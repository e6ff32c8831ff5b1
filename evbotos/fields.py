"""The values of definitions: their types, and what is checked of them with a place in the file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Annotated, Final
from urllib.parse import urlsplit

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.serialization import load_ssh_public_key
from pydantic import AfterValidator, Field

from eal_actors.kernel.strict_model import Name
from eal_actors.kernel.suggestions import did_you_mean

Text = Annotated[str, Field(min_length=1)]
Texts = Annotated[tuple[Text, ...], Field(strict=False)]
PackageName = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9+.-]+$")]
PackagePattern = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9+.*-]+$")]
WheelName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*(\[[a-z,]+\])?([=<>!~].*)?$")]
ROOTFS: Final = Path(__file__).parent / "rootfs"
"""The parent of the files that images copy onto their root."""
FRAGMENTS: Final = Path(__file__).parent / "kernel"
"""The parent of the parts of kernels' configurations."""
OVERLAYS: Final = Path(__file__).parent / "overlays"
"""The parent of the device tree overlays."""
_SCHEMES: Final = ("http", "https", "file", "ftp")
_SECURITY_KEYS: Final = ("sk-ssh-ed25519@openssh.com AAAA", "sk-ecdsa-sha2-nistp256@openssh.com AAAA")
KERNEL_MB: Final = 6
"""The most that a kernel takes of an image's budget."""
SMALLEST_BOOT_MIB: Final = 16
"""Two kernels of six MiB, and U-Boot with the board's loaders."""
LARGEST_MIB: Final = 1 << 20
"""A partition table of MS-DOS ends at two TiB."""


def _service(name: str) -> str:
    return _folder_of(ROOTFS / "services", name, "service")


def _layer(name: str) -> str:
    return _folder_of(ROOTFS, name, "folder of files")


def _fragment(name: str) -> str:
    known = sorted(path.name for path in FRAGMENTS.glob("*.config"))
    if name not in known:
        raise ValueError(f"there is no kernel fragment '{name}'{did_you_mean(name, known)}")
    return name


def _folder_of(parent: Path, name: str, kind: str) -> str:
    known = sorted(path.name for path in parent.iterdir() if path.is_dir())
    if name not in known:
        raise ValueError(f"there is no {kind} '{name}'{did_you_mean(name, known)}")
    return name


def _mirror(address: str) -> str:
    parts = urlsplit(address)
    if parts.scheme not in _SCHEMES or not (parts.netloc or parts.scheme == "file") or len(address.split()) != 1:
        raise ValueError(f"must be an address such as https://deb.debian.org/debian, not {address!r}")
    return address


def _ssh_key(line: str) -> str:
    """Check a line of authorized_keys without options, as dropbear reads it."""
    if line.startswith(_SECURITY_KEYS):
        return line  # `cryptography` does not read those
    try:
        load_ssh_public_key(line.strip().encode())
    except (ValueError, UnsupportedAlgorithm):
        raise ValueError(f"is not a public SSH key such as 'ssh-ed25519 AAAA... me': {line[:40]!r}") from None
    if len(line.strip().splitlines()) != 1:
        raise ValueError("must be one line for each key")
    return line


@dataclass(frozen=True, slots=True)
class ArchitectureNames:
    """The names that the tools give an architecture."""

    kernel: str
    emulator: str
    wheels: str
    is_pc: bool = False


MACHINES: Final = {
    "amd64": ArchitectureNames("x86_64", "qemu-system-x86_64", "x86_64", is_pc=True),
    "i386": ArchitectureNames("i386", "qemu-system-i386", "i686", is_pc=True),
    "armhf": ArchitectureNames("arm", "qemu-system-arm", "armv7l"),
    "arm64": ArchitectureNames("arm64", "qemu-system-aarch64", "aarch64"),
}


def _file_name(name: str) -> str:
    if PurePath(name).name != name or name in (".", ".."):
        raise ValueError(f"must be a file name on the boot partition, without a folder, not {name!r}")
    return name


def overlay_file(name: str) -> Path:
    """Return the file of an overlay: one of `evbotos/overlays/`, or a user's own."""
    return bundled if (bundled := OVERLAYS / name).is_file() else Path(name)


def _overlay(name: str) -> str:
    if not overlay_file(name).is_file():
        known = [path.name for path in OVERLAYS.glob("*.dts")]
        raise ValueError(f"there is no file {name}, here or in evbotos/overlays{did_you_mean(name, known)}")
    return name


def _folder(place: str) -> str:
    if not Path(place).is_dir():
        raise ValueError(f"there is no folder {place}")
    return place


def _file(place: str) -> str:
    if not Path(place).is_file():
        raise ValueError(f"there is no file {place}")
    return place


FileName = Annotated[str, AfterValidator(_file_name)]
ServiceName = Annotated[Name, AfterValidator(_service)]
LayerName = Annotated[Name, AfterValidator(_layer)]
Fragments = Annotated[tuple[Annotated[str, AfterValidator(_fragment)], ...], Field(strict=False)]
Overlays = Annotated[tuple[Annotated[Text, AfterValidator(_overlay)], ...], Field(strict=False)]
Mirror = Annotated[str, AfterValidator(_mirror)]
SshKey = Annotated[str, AfterValidator(_ssh_key)]
Mebibytes = Annotated[int, Field(gt=0, le=LARGEST_MIB)]
Folder = Annotated[str, AfterValidator(_folder)]
File = Annotated[str, AfterValidator(_file)]
