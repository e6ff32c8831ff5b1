"""The robot's process runs as the user `robot`, without any of root's rights.

Only root reads the boot partition, because it holds the SSH host key. So root reads the robot's own files, gives up its
rights for good, and writes them as the robot to a folder of the data partition, where the robot also keeps its list of
revoked certificates. Root writes nothing into that folder, because a link that the robot puts there would lead it
astray. If the data partition is full, read-only or damaged, the folder is in RAM.
"""

from __future__ import annotations

import ctypes
import os
import pwd
import resource
import shutil
import sys
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

_STATE: Final = Path("/run/evbotos")
_DEFAULT: Final = Path("/usr/share/evbotos/fleet.yaml")
_COPY: Final = Path("/data/serve")
_IN_RAM: Final = Path("/run/serve")
_SECRETS: Final = ("host_ed25519", "authorized_keys", "update_key", "wifi.conf")
"""Files of an identity for SSH, updates and Wi-Fi, which the robot must not read."""
_REVOKED: Final = "revoked.txt"
_AUTHORITY: Final = "ca.pem"
_USER: Final = "robot"
_MOST_THREADS: Final = 128
"""Threads of all processes of the robot's user. A robot with 12 resources and 120 controllers has 45: one for each
resource, 33 others. A fork bomb of shells gets the rest, 10 MB; without a bound it took the machine down."""
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
        """Write a line to the console and to the log, with the user's path of the fleet file's folder."""
        shown = words.replace(f"{self.fleet.parent}/", f"{self.source.parent}/")
        os.write(self.console, f"evbotos: {shown}\n".encode(errors="replace"))
        sys.stderr.write(f"{shown}\n")


def find_fleet() -> Path:
    """Return the fleet file to use: of a USB stick, else the data, boot or root partition."""
    sticks = sorted(Path("/media").glob("*/fleet.yaml"))
    places = [*sticks, Path("/data/robot/fleet.yaml"), Path("/boot/robot/fleet.yaml")]
    return next((place for place in places if place.is_file()), _DEFAULT)


def become_robot() -> Own:
    """Read the robot's files, give up the rights of root, and write the robot's copy.

    Raises:
        OSError: a file cannot be read or written, or the rights cannot be given up.
    """
    user = pwd.getpwnam(_USER)
    source = find_fleet()
    contents = read_files(source.parent) if source.parent.name == "robot" else None
    for folder in (_COPY, _IN_RAM):
        with suppress(OSError):
            _give(folder, user)
    (_STATE / "robot.pid").write_text(str(os.getpid()))
    up = _STATE / "robot.up"
    up.write_text("")
    os.chown(up, user.pw_uid, user.pw_gid)
    console = os.open("/dev/console", os.O_WRONLY | os.O_NOCTTY | os.O_CLOEXEC)
    bound_threads()
    os.initgroups(_USER, user.pw_gid)
    os.setresgid(user.pw_gid, user.pw_gid, user.pw_gid)
    os.setresuid(user.pw_uid, user.pw_uid, user.pw_uid)
    if ctypes.CDLL(None, use_errno=True).prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "the kernel keeps programs from giving up their rights")
    os.environ["HOME"] = str(_COPY)
    own = Own(source, source, console)
    return own if contents is None else _copied(own, contents)


def bound_threads() -> None:
    """Bound the threads that this process and its children may have once they are no longer root's."""
    resource.setrlimit(resource.RLIMIT_NPROC, (_MOST_THREADS, _MOST_THREADS))


def _give(folder: Path, user: pwd.struct_passwd) -> None:
    """Make a folder the robot's, with what is in it; no link is followed."""
    folder.mkdir(mode=0o700, exist_ok=True)
    os.chown(folder, user.pw_uid, user.pw_gid, follow_symlinks=False)
    for _, folders, files, descriptor in os.fwalk(folder):
        for name in (*folders, *files):
            os.chown(name, user.pw_uid, user.pw_gid, dir_fd=descriptor, follow_symlinks=False)


def _copied(own: Own, contents: Mapping[Path, bytes]) -> Own:
    """Write the robot's files to the data partition, or to RAM if they cannot be written there."""
    contents = {**contents, **_revoked_lists((_COPY, _IN_RAM), contents)}
    try:
        write_files(contents, _COPY)
    except OSError as error:
        own.say(f"the data partition cannot be written, so changes are lost at power-off: {error}")
        write_files(contents, _IN_RAM)
        return replace(own, fleet=_IN_RAM / own.source.name)
    return replace(own, fleet=_COPY / own.source.name)


def read_files(source: Path) -> dict[Path, bytes]:
    """Return the content of the robot's files by their names below a folder."""
    paths = [path for path in source.rglob("*") if path.is_file() and path.name not in _SECRETS]
    return {path.relative_to(source): path.read_bytes() for path in paths}


def write_files(contents: Mapping[Path, bytes], target: Path) -> None:
    """Make a folder equal to some files, writing only what differs.

    Raises:
        OSError: a file cannot be written.
    """
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


def _revoked_lists(copies: Iterable[Path], contents: Mapping[Path, bytes]) -> dict[Path, bytes]:
    """Return the lists of revoked certificates that the robot has kept, joined with the new ones.

    A list is kept as long as the fleet's authority is the same.
    """
    found: dict[Path, bytes] = {}
    for target in copies:
        for kept in target.rglob(_REVOKED):
            name = kept.relative_to(target)
            authority, revoked = name.with_name(_AUTHORITY), _content(kept)
            if revoked is not None and authority in contents and _content(target / authority) == contents[authority]:
                lines = {*revoked.splitlines(), *found.get(name, contents.get(name, b"")).splitlines()}
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
