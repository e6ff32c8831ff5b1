"""Ends of ports for tests: a pseudo-terminal that can be unplugged, and a TCP listener that can go away."""

from __future__ import annotations

import os
import pty
import select
import socket
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest

from eal_actors.device.ports import ReopeningPort

WAIT_S: Final = 20.0


class Cable:
    """A device path under which a pseudo-terminal can be plugged in and out."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.device = -1
        self._port = -1

    def plug_in(self) -> None:
        self.device, self._port = pty.openpty()
        tty.setraw(self._port)
        fresh = self.path.with_suffix(".new")
        fresh.symlink_to(os.ttyname(self._port))
        fresh.replace(self.path)

    def unplug(self) -> None:
        if self.device >= 0:
            self.path.unlink()
            os.close(self._port)
            os.close(self.device)
            self.device = -1

    def hear(self, size: int) -> bytes:
        return read_exactly(self.device, size)

    def say(self, data: bytes) -> None:
        os.write(self.device, data)


def read_exactly(descriptor: int, size: int) -> bytes:
    heard = b""
    while len(heard) < size:
        assert select.select([descriptor], [], [], WAIT_S)[0], f"only {heard!r} came"
        heard += os.read(descriptor, size - len(heard))
    return heard


@pytest.fixture
def cable(tmp_path: Path) -> Iterator[Cable]:
    cable = Cable(tmp_path / "ttyUSB0")
    yield cable
    cable.unplug()


class Server:
    """A TCP listener that can go away and come back at the same port."""

    def __init__(self) -> None:
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self.listener.getsockname()[1])
        self.url = f"socket://127.0.0.1:{self.port}"
        self.peer: socket.socket | None = None

    def accept(self) -> socket.socket:
        self.listener.settimeout(WAIT_S)
        self.peer, _ = self.listener.accept()
        self.peer.settimeout(WAIT_S)
        return self.peer

    def go_away(self) -> None:
        self.listener.close()
        if self.peer is not None:
            self.peer.close()

    def come_back(self) -> None:
        self.listener = socket.create_server(("127.0.0.1", self.port))


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server()
    yield server
    server.go_away()


def drain(port: ReopeningPort, size: int, source: Any) -> bytes:
    """Read bytes that are on their way; `source` is what becomes readable when some are there."""
    heard = b""
    while len(heard) < size:
        assert select.select([source], [], [], WAIT_S)[0], f"only {heard!r} came"
        heard += port.read(size - len(heard))
    return heard
