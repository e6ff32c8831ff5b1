"""A connection to the program of EvBotOS that may write the other slot, which the robot's process may not."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Generator
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from eal_actors.plugin import ArgumentError, Clock, NotReadyError, UnsupportedError

_SOCKET: Final = "update.sock"
_WAKE: Final = "update.wake"
_LOOK_S: Final = 0.01
_START_S: Final = 60.0
_PIECE_BYTES: Final = 1 << 18


class RootSide:
    """Sends requests one after the other; each is an activity.

    Args:
        state: the folder with the program's socket, and the pipe that starts it.
    """

    def __init__(self, state: Path, clock: Clock) -> None:
        self._state = state
        self._clock = clock
        self._socket: socket.socket | None = None
        self._is_busy = False

    def exists(self) -> bool:
        """Return whether this computer runs EvBotOS with two slots."""
        return (self._state / "slot").is_file()

    def close(self) -> None:
        """End the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def ask(self, do: str, body: bytes = b"", **fields: Any) -> Generator[float, None, bytes]:
        """Send a request and return the answer's bytes.

        Raises:
            ArgumentError: the program refuses it.
            NotReadyError: the program does not start or has ended, or the running slot is not good yet.
            UnsupportedError: this computer has no such program.
        """
        if not self.exists():
            raise UnsupportedError("this computer does not run EvBotOS with two slots")
        if not (self._state / _WAKE).exists():
            raise NotReadyError("the running slot is not good yet; it is after its robot has served for five seconds")
        while self._is_busy:
            yield _LOOK_S
        self._is_busy, is_done = True, False
        try:
            connection = yield from self._connected()
            line = json.dumps({"do": do, "bytes": len(body), **fields}).encode() + b"\n"
            yield from self._send(connection, line + body)
            told, content = yield from self._receive(connection)
            is_done = True
        except OSError as error:
            raise NotReadyError(f"the program that takes updates has ended: {error.strerror or error}") from error
        finally:
            self._is_busy = False
            if not is_done:
                self.close()  # an answer to this request must not be taken for the next one's
        if "error" in told:
            raise ArgumentError(str(told["error"]))
        return content

    def _connected(self) -> Generator[float, None, socket.socket]:
        if self._socket is not None and self._has_ended(self._socket):
            self.close()  # the program ends a silent connection
        end_s = self._clock.now() + _START_S
        while self._socket is None:
            connection = socket.socket(socket.AF_UNIX)
            try:
                connection.connect(str(self._state / _SOCKET))
            except OSError:
                connection.close()
                if self._clock.now() >= end_s:
                    raise
                self._wake()
                yield 10 * _LOOK_S
            else:
                connection.setblocking(False)
                self._socket = connection
        return self._socket

    @staticmethod
    def _has_ended(connection: socket.socket) -> bool:
        try:
            return not connection.recv(1, socket.MSG_PEEK)
        except BlockingIOError:
            return False

    def _wake(self) -> None:
        with suppress(OSError):  # it has been woken already, and is starting
            pipe = os.open(self._state / _WAKE, os.O_WRONLY | os.O_NONBLOCK)
            try:
                os.write(pipe, b"\n")
            finally:
                os.close(pipe)

    @staticmethod
    def _send(connection: socket.socket, data: bytes) -> Generator[float, None, None]:
        rest = memoryview(data)
        while rest:
            try:
                rest = rest[connection.send(rest[:_PIECE_BYTES]) :]
            except BlockingIOError:
                yield _LOOK_S

    @staticmethod
    def _receive(connection: socket.socket) -> Generator[float, None, tuple[dict[str, Any], bytes]]:
        received = bytearray()
        while True:
            line, found, rest = received.partition(b"\n")
            told: dict[str, Any] = json.loads(line) if found else {}
            if found and len(rest) >= told["bytes"]:
                return told, bytes(rest)
            try:
                piece = connection.recv(_PIECE_BYTES)
            except BlockingIOError:
                yield _LOOK_S
                continue
            if not piece:
                raise ConnectionResetError("it closed the connection")
            received += piece
