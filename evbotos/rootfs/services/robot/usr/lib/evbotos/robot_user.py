"""The robot's process runs as the user `robot`, without any of root's rights.

Only root reads the boot partition, because it holds the SSH host key. So root copies the robot's own files to a folder
of the data partition, where the robot also keeps its list of revoked certificates, and gives up its rights for good.
"""

from __future__ import annotations

import ctypes
import os
import pwd
import shutil
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

_STATE: Final = Path("/run/evbotos")
_DEFAULT: Final = Path("/usr/share/evbotos/fleet.yaml")
_COPY: Final = Path("/data/serve")
_SECRETS: Final = ("host_ed25519", "authorized_keys", "update_key", "wifi.conf")
"""Files of an identity for SSH, updates and Wi-Fi, which the robot must not read."""
_REVOKED: Final = "revoked.txt"
_AUTHORITY: Final = "ca.pem"
_USER: Final = "robot"
_NO_NEW_PRIVILEGES: Final = 38
"""The kernel's PR_SET_NO_NEW_PRIVS: no program that it starts gains rights."""


@dataclass(frozen=True)
class Own:
    """The files that root has found and opened for the robot.

    Attributes:
        source: the fleet file as the user knows it.
        fleet: the fleet file to load.
        console: a file descriptor of the console.
    """

    source: Path
    fleet: Path
    console: int

    def say(self, words: str) -> None:
        """Write a line to the console, with the user's path of the fleet file's folder."""
        shown = words.replace(f"{self.fleet.parent}/", f"{self.source.parent}/")
        os.write(self.console, f"evbotos: {shown}\n".encode())


def find_fleet() -> Path:
    """Return the fleet file to use: of a USB stick, else the data, boot or root partition."""
    sticks = sorted(Path("/media").glob("*/fleet.yaml"))
    places = [*sticks, Path("/data/robot/fleet.yaml"), Path("/boot/robot/fleet.yaml")]
    return next((place for place in places if place.is_file()), _DEFAULT)


def become_robot() -> Own:
    """Prepare the robot's files, and give up the rights of root.

    Raises:
        OSError: a file cannot be copied, or the rights cannot be given up.
    """
    user = pwd.getpwnam(_USER)
    source = fleet = find_fleet()
    if source.parent.name == "robot":
        copy_files(source.parent, _COPY)
        fleet = _COPY / source.name
        for path in (_COPY, *_COPY.rglob("*")):
            os.chown(path, user.pw_uid, user.pw_gid, follow_symlinks=False)
    (_STATE / "robot.pid").write_text(str(os.getpid()))
    up = _STATE / "robot.up"
    up.write_text("")
    os.chown(up, user.pw_uid, user.pw_gid)
    own = Own(source, fleet, os.open("/dev/console", os.O_WRONLY | os.O_NOCTTY | os.O_CLOEXEC))
    os.initgroups(_USER, user.pw_gid)
    os.setresgid(user.pw_gid, user.pw_gid, user.pw_gid)
    os.setresuid(user.pw_uid, user.pw_uid, user.pw_uid)
    if ctypes.CDLL(None, use_errno=True).prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "the kernel keeps programs from giving up their rights")
    os.environ["HOME"] = str(_COPY)
    return own


def copy_files(source: Path, target: Path) -> None:
    """Make a folder equal to the robot's files, writing only what differs; revoked certificates stay revoked.

    Args:
        source: the folder of the fleet file.
        target: the copy. Its lists of revoked certificates are kept as long as the fleet's authority is the same.
    """
    paths = [path for path in source.rglob("*") if path.is_file() and path.name not in _SECRETS]
    contents = {path.relative_to(source): path.read_bytes() for path in paths}
    contents |= _revoked_lists(target, contents)
    target.mkdir(mode=0o700, exist_ok=True)
    _remove_others(target, contents)
    for name, content in contents.items():
        place = target / name
        if _content(place) != content:
            place.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            part = place.with_name(f".{place.name}.part")
            part.write_bytes(content)
            part.chmod(0o600)
            part.replace(place)


def _revoked_lists(target: Path, contents: Mapping[Path, bytes]) -> dict[Path, bytes]:
    """Return the lists of revoked certificates that the robot has kept, joined with the new ones."""
    found = {}
    for kept in target.rglob(_REVOKED):
        name = kept.relative_to(target)
        authority, revoked = name.with_name(_AUTHORITY), _content(kept)
        if revoked is not None and authority in contents and _content(target / authority) == contents[authority]:
            lines = {*revoked.splitlines(), *contents.get(name, b"").splitlines()}
            found[name] = b"".join(line + b"\n" for line in sorted(lines))
    return found


def _remove_others(target: Path, contents: Collection[Path]) -> None:
    """Remove every link, and the files and folders that are not wanted."""
    folders = {parent for name in contents for parent in name.parents}
    for path in sorted(target.rglob("*"), reverse=True):
        name = path.relative_to(target)
        if path.is_dir() and not path.is_symlink():
            if name not in folders:
                shutil.rmtree(path)
        elif path.is_symlink() or name not in contents:
            path.unlink()


def _content(path: Path) -> bytes | None:
    return path.read_bytes() if path.is_file() and not path.is_symlink() else None
