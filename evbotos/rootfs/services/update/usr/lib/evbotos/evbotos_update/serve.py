"""Serve the robot's process, which receives updates over the fleet's network and has no rights of root.

It may write the slot that does not run, after a manifest with a valid signature, restart a machine that has an update
to try, and take back a slot that became permanent in this start. Nothing that it sends makes a slot start that is not
the signed one: `installation` reads both parts back first.

A message is a line of JSON and as many bytes as its `bytes` says, both ways. One connection is served at a time, and
the program ends after a minute without one, so that it takes no memory between updates.
"""

from __future__ import annotations

import grp
import json
import os
import socket
import struct
import subprocess
from collections.abc import Callable
from contextlib import ExitStack, nullcontext
from pathlib import Path
from typing import IO, Any, Final, cast

from . import installation, slot_state
from .blocks import digests
from .installation import Installation, RefusedError, other_slot, running_slot, size_of, targets_of
from .slot_state import STATE, hash_file, read_block, read_choice, writable_boot

SOCKET: Final = "update.sock"
_START: Final = Path("/proc/sys/kernel/random/boot_id")
_GROUP: Final = "robot"
_SILENCE_S: Final = 60.0
_MOST_BYTES: Final = 4 << 20
_PIECE: Final = struct.Struct(">cBQI")
"""A piece of a write: `d` for data that follows or `c` for a copy from the running slot, part, place, length."""
_SOURCE: Final = struct.Struct(">BQ")
"""Of a copy: part and place in the running slot."""
_PARTS: Final = ("kernel", "root")


class Session:
    """One connection of the robot's process."""

    def __init__(self) -> None:
        self._begun: Installation | None = None
        self._held = ExitStack()
        self._operations: dict[str, Callable[..., bytes]] = {
            "status": self._status,
            "digests": self._digests,
            "begin": self._begin,
            "write": self._write,
            "finish": self._finish,
            "restart": self._restart,
            "fall_back": self._fall_back,
        }

    def close(self) -> None:
        """Let others install updates."""
        self._begun = None
        self._held.close()

    def answer(self, asked: dict[str, Any], body: bytes) -> bytes:
        """Carry out a request and return the answer's bytes.

        Raises:
            RefusedError: it is not allowed, or unknown.
        """
        operation = self._operations.get(str(asked.get("do")))
        if operation is None:
            raise RefusedError(f"there is no {asked.get('do')!r}; known: {', '.join(self._operations)}")
        return operation(asked, body)

    def _status(self, _asked: dict[str, Any], _body: bytes) -> bytes:
        running, values = running_slot(), read_choice()
        told = {
            "start": _START.read_text().strip(),
            "slot": running,
            "good": installation.is_good(),
            "due": values.get("try") == other_slot(),
            "release": installation.own_release(),
            "platform": (installation.ABOUT / "platform").read_text().strip(),
            "verity": read_block(hash_file(running)).get("verity", ""),
            "other_verity": read_block(hash_file(other_slot())).get("verity", ""),
        }
        return json.dumps(told).encode()

    def _digests(self, asked: dict[str, Any], _body: bytes) -> bytes:
        slot = running_slot() if asked.get("slot") == "running" else other_slot()
        target = targets_of(slot)[_part(asked.get("part"))]
        return digests(target, min(size_of(target), int(asked.get("size", 0))))

    def _begin(self, asked: dict[str, Any], body: bytes) -> bytes:
        length = int(asked.get("signed", 0))
        self.close()
        with ExitStack() as held:
            try:
                held.enter_context(slot_state.locked("update", wait=False))
            except BlockingIOError:
                raise RefusedError("another update is being installed") from None
            self._begun = installation.begin(body[:length], body[length:])
            self._held = held.pop_all()  # until the next one, or the end of the connection
        return b""

    def _write(self, _asked: dict[str, Any], body: bytes) -> bytes:
        begun, sources = self._require_begun(), targets_of(running_slot())
        targets, place = begun.targets, 0
        with ExitStack() as opened:
            files: dict[str, IO[bytes]] = {}
            while place < len(body):
                kind, number, start, length = _PIECE.unpack_from(body, place)
                place += _PIECE.size
                part = _PARTS[number]
                if length > _MOST_BYTES:  # a copy is as long as it says, and passes through the memory
                    raise RefusedError(f"a piece has up to {_MOST_BYTES} bytes")
                if start + length > begun.manifest[part]["size"]:
                    raise RefusedError(f"{part} has only {begun.manifest[part]['size']} bytes")
                if kind == b"c":
                    source, at = _SOURCE.unpack_from(body, place)
                    place += _SOURCE.size
                    with sources[_PARTS[source]].open("rb") as file:
                        file.seek(at)
                        data = file.read(length)
                else:
                    data = body[place : place + length]
                    place += length
                if len(data) != length:
                    raise RefusedError(f"{length} bytes for {part} were announced, and there are {len(data)}")
                if part not in files:
                    opened.enter_context(writable_boot() if part == "kernel" else nullcontext())
                    files[part] = opened.enter_context(targets[part].open("r+b"))
                files[part].seek(start)
                files[part].write(data)
        return b""

    def _finish(self, _asked: dict[str, Any], _body: bytes) -> bytes:
        begun = self._require_begun()
        os.sync()
        for part in _PARTS:
            installation.require_part(begun, part)
        return installation.finish(begun).encode()

    def _restart(self, _asked: dict[str, Any], _body: bytes) -> bytes:
        if read_choice().get("try") != other_slot():
            raise RefusedError("there is no update to try")
        subprocess.Popen(["reboot", "-d", "1"])  # after the answer
        return b""

    def _fall_back(self, _asked: dict[str, Any], _body: bytes) -> bytes:
        installation.fall_back()
        return b""

    def _require_begun(self) -> Installation:
        if self._begun is None:
            raise RefusedError("no update has begun")
        return self._begun


def _part(name: object) -> str:
    if name not in _PARTS:
        raise RefusedError(f"there is no part {name!r}; known: {', '.join(_PARTS)}")
    return str(name)


def serve() -> None:
    """Serve one connection after the other until none comes for a minute."""
    path = STATE / SOCKET
    path.unlink(missing_ok=True)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        os.chown(path, -1, grp.getgrnam(_GROUP).gr_gid)
        path.chmod(0o660)
        listener.listen()
        listener.settimeout(_SILENCE_S)
        try:
            while True:
                connection, _ = listener.accept()
                with connection:
                    serve_connection(connection)
        except TimeoutError:
            path.unlink(missing_ok=True)


def serve_connection(connection: socket.socket) -> None:
    """Answer the requests of a connection until it ends or is silent for a minute."""
    connection.settimeout(_SILENCE_S)
    session = Session()
    try:
        with cast("IO[bytes]", connection.makefile("rwb")) as stream:
            while line := stream.readline(_MOST_BYTES):
                asked = json.loads(line)
                length = int(asked.get("bytes", 0))
                if not 0 <= length <= _MOST_BYTES:
                    return
                _reply(stream, session, asked, stream.read(length))
    except (OSError, ValueError):
        return  # it is silent, has gone, or does not speak this language
    finally:
        session.close()


def _reply(stream: IO[bytes], session: Session, asked: dict[str, Any], body: bytes) -> None:
    told: dict[str, Any] = {}
    try:
        content = session.answer(asked, body)
    except (RefusedError, OSError, ValueError, struct.error, IndexError, KeyError) as error:
        content, told = b"", {"error": str(error) or type(error).__name__}
    stream.write(json.dumps({**told, "bytes": len(content)}).encode() + b"\n" + content)
    stream.flush()
