"""Wires between a plugin and an emulated device, which can be unplugged and plugged in again."""

from __future__ import annotations

import contextlib
import os
import selectors
import socket
import tempfile
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Final, Protocol

from typing_extensions import override

from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.posix import pty, tty

TICK_S: Final = 0.01
"""Real seconds between calls of an emulator without input, which let it send by itself."""
LOCAL: Final = ("127.0.0.1", 0)
"""Any port of this machine, for this machine alone."""
_MOST_BYTES: Final = 4096
_MOST_UNSENT: Final = 1 << 20  # a client that does not read loses what comes then
_DRAIN_S: Final = 5.0  # limit for an emulator whose input never pauses


class DeviceEmulator(Protocol):
    """An emulated device: bytes in, bytes out. Thread: its wire's.

    If it also has `connected()`, TCP calls that when a client connects.
    """

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Process received bytes, possibly none, and return the bytes that it sends by `now_s`."""


class EmulatorWire(ABC):
    """A port with an emulator behind it while plugged in; each plugging in makes a new emulator.

    `address` is the device path, or `host:port`, and constant. Thread: its owner's; the emulator runs in its own
    thread.
    """

    address: str
    _selector: selectors.BaseSelector

    def __init__(self, make: Callable[[], DeviceEmulator], tick_s: float) -> None:
        self._make = make
        self._tick_s = tick_s
        self._thread: threading.Thread | None = None
        self._stop_reader, self._stop_writer = socket.socketpair()
        self._is_drained = threading.Event()
        self._has_ended = threading.Event()
        self.emulator = make()

    @abstractmethod
    def _begin(self) -> None:
        """Create the port."""

    @abstractmethod
    def _end(self) -> None:
        """Remove the port."""

    @abstractmethod
    def _watch(self) -> None:
        """Register the sources of bytes with the selector."""

    @abstractmethod
    def _exchange(self, ready: set[int]) -> None:
        """Transfer bytes in both directions; `ready` has the readable descriptors."""

    def plug_in(self) -> None:
        """Create the port, with a new emulator behind it."""
        self.emulator = self._make()
        self._begin()
        self._has_ended.clear()
        self._thread = threading.Thread(target=self._serve, name=f"emulator at {self.address}", daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        """Remove the port; do nothing if it is unplugged."""
        if self._thread is not None:
            self._stop_writer.send(b"x")
            self._thread.join()
            self._stop_reader.recv(1)
            self._thread = None
            self._end()

    def drain(self) -> None:
        """Wait until the emulator has read all bytes on the wire. Thread: blocks the caller."""
        self._is_drained.clear()
        if self._thread is not None:
            self._is_drained.wait(_DRAIN_S)

    def join(self) -> None:
        """Wait until its emulator fails; a signal handler may end the wait. Thread: blocks the caller.

        Python 3.11 takes a thread for ended whose `join` a signal handler ends: `unplug` would not wait for it.
        """
        if self._thread is not None:
            self._has_ended.wait()

    def close(self) -> None:
        """Unplug, and release all resources."""
        self.unplug()
        self._stop_reader.close()
        self._stop_writer.close()

    def _serve(self) -> None:
        try:
            self._transfer()
        finally:
            self._has_ended.set()

    def _transfer(self) -> None:
        with selectors.DefaultSelector() as self._selector:
            self._selector.register(self._stop_reader, selectors.EVENT_READ)
            self._watch()
            while True:
                ready = {key.fd for key, _ in self._selector.select(self._tick_s)}
                if self._stop_reader.fileno() in ready:
                    return
                self._exchange(ready)
                if not ready:
                    self._is_drained.set()

    def _reply_to(self, data: bytes) -> bytes:
        return self.emulator.feed(data, REAL_TIME.now())


class PtyWire(EmulatorWire):
    """A pseudo-terminal under a path of its own: a serial port."""

    def __init__(
        self,
        make: Callable[[], DeviceEmulator],
        tick_s: float = TICK_S,
        at: tuple[str, int] = LOCAL,  # noqa: ARG002  # a path needs none
    ) -> None:
        super().__init__(make, tick_s)
        self._folder = tempfile.TemporaryDirectory(prefix="eal-")
        self._path = Path(self._folder.name) / "tty"
        self.address = str(self._path)
        self._device = self._port = -1

    def _begin(self) -> None:
        self._device, self._port = pty.openpty()  # kept open: otherwise the device sees a hang-up of its only user
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
            with contextlib.suppress(BlockingIOError):  # a full buffer without a reader: the bytes are lost
                os.write(self._device, reply)

    @override
    def close(self) -> None:
        super().close()
        self._folder.cleanup()


class TcpWire(EmulatorWire):
    """A TCP server; only its last client is connected."""

    def __init__(self, make: Callable[[], DeviceEmulator], tick_s: float = TICK_S, at: tuple[str, int] = LOCAL) -> None:
        super().__init__(make, tick_s)
        with socket.create_server(at) as probe:
            self._at = at[0], int(probe.getsockname()[1])
        self.address = f"{self._at[0]}:{self._at[1]}"
        self._listener: socket.socket
        self._peer: socket.socket | None = None
        self._unsent = bytearray()

    def _begin(self) -> None:
        self._listener = socket.create_server(self._at)

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
            self._unsent.clear()
            self._selector.register(self._peer, selectors.EVENT_READ)
            getattr(self.emulator, "connected", lambda: None)()
        if self._peer is None:
            return
        try:
            data = self._peer.recv(_MOST_BYTES) if self._peer.fileno() in ready else None
            if data != b"":
                reply = self._reply_to(data or b"")
                if len(self._unsent) < _MOST_UNSENT:
                    self._unsent += reply
                del self._unsent[: self._peer.send(self._unsent)]
                return
        except BlockingIOError:
            return
        except OSError:
            pass
        self._selector.unregister(self._peer)
        self._hang_up()


class UdpWire(EmulatorWire):
    """A UDP socket, which answers the last sender."""

    def __init__(self, make: Callable[[], DeviceEmulator], tick_s: float = TICK_S, at: tuple[str, int] = LOCAL) -> None:
        super().__init__(make, tick_s)
        with socket.socket(type=socket.SOCK_DGRAM) as probe:
            probe.bind(at)
            self._at = at[0], int(probe.getsockname()[1])
        self.address = f"{self._at[0]}:{self._at[1]}"
        self._socket: socket.socket
        self._peer: tuple[str, int] | None = None

    def _begin(self) -> None:
        self._socket = socket.socket(type=socket.SOCK_DGRAM)
        self._socket.bind(self._at)
        self._socket.setblocking(False)
        self._peer = None

    def _end(self) -> None:
        self._socket.close()

    def _watch(self) -> None:
        self._selector.register(self._socket, selectors.EVENT_READ)

    def _exchange(self, ready: set[int]) -> None:
        data = b""
        with contextlib.suppress(OSError):  # the other end is closed
            if self._socket.fileno() in ready:
                data, self._peer = self._socket.recvfrom(65536)
            reply = self._reply_to(data)
            if reply and self._peer is not None:
                self._socket.sendto(reply, self._peer)


WIRES: Final[dict[str, type[PtyWire | TcpWire | UdpWire]]] = {"pty": PtyWire, "tcp": TcpWire, "udp": UdpWire}
"""Wires by the name in a manifest's `emulator`."""
