"""Install an update from a file or a pipe: the program `evbotos-update`.

An update is a tar of `manifest.json`, its signature (ed25519, 64 bytes), the kernel and the root file system, in this
order. It is written while it arrives.
"""

from __future__ import annotations

import os
import select
import subprocess
import sys
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Final

from . import installation, slot_state
from .installation import CHUNK, Installation, RefusedError
from .slot_state import read_choice, writable_boot

_SILENCE_S: Final = 60.0
"""The longest time without a byte of an update."""


class Patient:
    """A stream that ends with an error if nothing arrives for a minute."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream

    def read(self, size: int) -> bytes:
        """Return up to `size` bytes."""
        if not select.select([self._stream], [], [], _SILENCE_S)[0]:
            raise RefusedError(f"nothing arrived for {_SILENCE_S:g} s")
        return os.read(self._stream.fileno(), size)


def install(stream: IO[bytes]) -> None:
    """Install an update into the other slot; the next boot tries it.

    Raises:
        RefusedError: the update is not trusted, not for this machine, too old, too large, or was not written correctly;
            or the running slot is not good yet, or another update is being installed.
    """
    installation.running_slot()
    try:
        with slot_state.locked("update", wait=False):
            _install(stream)
    except BlockingIOError:
        raise RefusedError("another update is being installed") from None


def _install(stream: IO[bytes]) -> None:
    with tarfile.open(fileobj=Patient(stream), mode="r|") as archive:  # type: ignore[call-overload]  # it only reads
        members = iter(archive)
        signed = _next(archive, members, "manifest.json").read(CHUNK)
        begun = installation.begin(signed, _next(archive, members, "manifest.sig").read(64))
        with writable_boot():
            _write(_next(archive, members, "kernel"), begun, "kernel")
        _write(_next(archive, members, "root"), begun, "root")
    sys.stdout.write(f"{installation.finish(begun)}\n")


def _next(archive: tarfile.TarFile, members: Iterator[tarfile.TarInfo], name: str) -> IO[bytes]:
    member = next(members, None)
    file = archive.extractfile(member) if member is not None and member.name == name else None
    if file is None:
        raise RefusedError(f"it lacks {name} where it should be")
    return file


def _write(source: IO[bytes], begun: Installation, part: str) -> None:
    """Copy a part to the start of its file or device, read back and compare."""
    target, left = begun.targets[part], begun.manifest[part]["size"]
    with target.open("r+b") as file:
        while left:
            chunk = source.read(min(left, CHUNK))
            if not chunk:
                raise RefusedError(f"it ends within {target.name}; the other slot is empty now")
            file.write(chunk)
            left -= len(chunk)
        file.flush()
        os.fsync(file.fileno())
    installation.require_part(begun, part)


def show_status() -> None:
    """Print the running slot and the slot state."""
    values = read_choice()
    sys.stdout.write(
        f"running {installation.running_slot()}; good {values.get('good')}; to be tried {values.get('try') or 'none'}\n"
    )


_USAGE: Final = "usage: evbotos-update status | install FILE (- for stdin) | good | is-good | serve\n"


def main() -> None:
    """Run the program."""
    words = sys.argv[1:]
    try:
        if words == ["status"]:
            show_status()
        elif words == ["good"]:
            if installation.mark_good():
                sys.stdout.write(f"slot {installation.running_slot()} is good\n")
        elif words == ["is-good"]:
            sys.exit(0 if installation.is_good() else 1)
        elif words == ["serve"]:
            from .serve import serve  # the others need not load it

            serve()
        elif len(words) == 2 and words[0] == "install":
            if words[1] == "-":
                install(sys.stdin.buffer)
            else:
                with Path(words[1]).open("rb") as file:
                    install(file)
        else:
            sys.stderr.write(_USAGE)
            sys.exit(2)
    except (RefusedError, OSError, ValueError, tarfile.TarError, subprocess.SubprocessError) as error:
        sys.stderr.write(f"evbotos-update: refused: {error}\n")
        sys.exit(1)


if __name__ == "__main__":
    main()
