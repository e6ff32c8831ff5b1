"""Wires to an emulator that stands in for a device, which can be pulled out and plugged in again."""

from __future__ import annotations

import contextlib
import os
import pty
import selectors
import socket
import tempfile
import threading
import tty
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Final, Protocol

from eal_actors.kernel.clock import REAL_TIME

TICK_S: Final = 0.01
"""How often (real time) an emulator gets nothing, so that it can say something of its own accord."""
_MOST_BYTES: Final = 4096
_SETTLE_S: Final = 5.0  # at most, of an emulator that never stops to listen


class Emulator(Protocol):
    """What stands in for a device: bytes in, bytes out. Thread: its wire's."""

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Take what came, which may be nothing, and return what it says by then."""
        ...


class Wire(ABC):
    """A place where an emulator can be found while it is plugged in; each time it is a new one.

    Attributes:
        address: the device path, or `host:port`; the same for as long as the wire lives.
        emulator: what is plugged in, or was last.

    Thread: its owner's; the emulator runs in one of its own.
    """

    address: str
    _selector: selectors.BaseSelector

    def __init__(self, make: Callable[[], Emulator]) -> None:
        self._make = make
        self._thread: threading.Thread | None = None
        self._ears, self._mouth = socket.socketpair()
        self._has_heard_all = threading.Event()
        self.emulator = make()

    @abstractmethod
    def _begin(self) -> None:
        """Make the place."""

    @abstractmethod
    def _end(self) -> None:
        """Remove the place."""

    @abstractmethod
    def _watch(self) -> None:
        """Register with the selector what bytes come from."""

    @abstractmethod
    def _exchange(self, ready: set[int]) -> None:
        """Carry bytes both ways; `ready` holds the descriptors with something to read."""

    def plug_in(self) -> None:
        """Have it found."""
        self.emulator = self._make()
        self._begin()
        self._thread = threading.Thread(target=self._serve, name=f"emulator at {self.address}", daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        """Have it vanish; harmless if it is not there."""
        if self._thread is not None:
            self._mouth.send(b"x")
            self._thread.join()
            self._ears.recv(1)
            self._thread = None
            self._end()

    def settle(self) -> None:
        """Wait until the emulator has heard whatever is on its way. Thread: blocks the caller."""
        self._has_heard_all.clear()
        if self._thread is not None:
            self._has_heard_all.wait(_SETTLE_S)

    def close(self) -> None:
        """Remove everything."""
        self.unplug()
        self._ears.close()
        self._mouth.close()

    def _serve(self) -> None:
        with selectors.DefaultSelector() as self._selector:
            self._selector.register(self._ears, selectors.EVENT_READ)
            self._watch()
            while True:
                ready = {key.fd for key, _ in self._selector.select(TICK_S)}
                if self._ears.fileno() in ready:
                    return
                self._exchange(ready)
                if not ready:
                    self._has_heard_all.set()

    def _reply_to(self, data: bytes) -> bytes:
        return self.emulator.feed(data, REAL_TIME.now())


class PtyWire(Wire):
    """A pseudo-terminal under a path of its own: a serial port."""

    def __init__(self, make: Callable[[], Emulator]) -> None:
        super().__init__(make)
        self._folder = tempfile.TemporaryDirectory(prefix="eal-")
        self._path = Path(self._folder.name) / "tty"
        self.address = str(self._path)
        self._device = self._port = -1

    def _begin(self) -> None:
        self._device, self._port = pty.openpty()  # kept open, or the device would see its only user hang up
        tty.setraw(self._port)
        os.set_blocking(self._device, False)
        self._path.symlink_to(os.ttyname(self._port))

    def _end(self) -> None:
        self._path.unlink()
        os.close(self._device)
        os.close(self._port)

    def _watch(self) -> None:
        self._selector.register(self._device, selectors.EVENT_READ)

    def _exchange(self, ready: set[int]) -> None:
        reply = self._reply_to(os.read(self._device, _MOST_BYTES) if self._device in ready else b"")
        if reply:
            with contextlib.suppress(BlockingIOError):  # nobody reads: the line loses it
                os.write(self._device, reply)

    def close(self) -> None:
        """See Wire."""
        super().close()
        self._folder.cleanup()


class TcpWire(Wire):
    """A TCP server on this machine; of its clients, the last one is heard."""

    def __init__(self, make: Callable[[], Emulator]) -> None:
        super().__init__(make)
        with socket.create_server(("127.0.0.1", 0)) as probe:
            self._port = int(probe.getsockname()[1])
        self.address = f"127.0.0.1:{self._port}"
        self._listener: socket.socket
        self._peer: socket.socket | None = None

    def _begin(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", self._port))

    def _end(self) -> None:
        self._listener.close()
        self._hang_up()

    def _hang_up(self) -> None:
        if self._peer is not None:
            self._peer.close()
            self._peer = None

    def _watch(self) -> None:
        self._selector.register(self._listener, selectors.EVENT_READ)

    def _exchange(self, ready: set[int]) -> None:
        if self._listener.fileno() in ready:
            if self._peer is not None:
                self._selector.unregister(self._peer)
                self._hang_up()
            self._peer, _ = self._listener.accept()
            self._peer.setblocking(False)
            self._selector.register(self._peer, selectors.EVENT_READ)
        if self._peer is None:
            return
        try:
            data = self._peer.recv(_MOST_BYTES) if self._peer.fileno() in ready else None
            if data != b"":
                self._peer.sendall(self._reply_to(data or b""))
                return
        except BlockingIOError:
            return
        except OSError:
            pass
        self._selector.unregister(self._peer)
        self._hang_up()


class UdpWire(Wire):
    """A UDP socket on this machine, which answers whoever spoke last."""

    def __init__(self, make: Callable[[], Emulator]) -> None:
        super().__init__(make)
        with socket.socket(type=socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self._port = int(probe.getsockname()[1])
        self.address = f"127.0.0.1:{self._port}"
        self._socket: socket.socket
        self._peer: tuple[str, int] | None = None

    def _begin(self) -> None:
        self._socket = socket.socket(type=socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", self._port))
        self._socket.setblocking(False)
        self._peer = None

    def _end(self) -> None:
        self._socket.close()

    def _watch(self) -> None:
        self._selector.register(self._socket, selectors.EVENT_READ)

    def _exchange(self, ready: set[int]) -> None:
        data = b""
        with contextlib.suppress(OSError):  # nobody listens at the other end any more
            if self._socket.fileno() in ready:
                data, self._peer = self._socket.recvfrom(65536)
            reply = self._reply_to(data)
            if reply and self._peer is not None:
                self._socket.sendto(reply, self._peer)


WIRES: Final[dict[str, Callable[[Callable[[], Emulator]], Wire]]] = {"pty": PtyWire, "tcp": TcpWire, "udp": UdpWire}
"""The wires by the name that a plugin's `conformance.py` gives them."""
