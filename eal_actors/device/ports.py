"""Ports that drivers speak through: bytes there and back, and ports that come back when their device does.

A driver opens its port through a `ReopeningPort`. While the device is away, the driver's resources are *not ready*
(`Resource.not_ready`), which is no reason to restart them; when it is back, they work on.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import socket
import struct
import termios
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Final, Protocol, TypeVar
from urllib.parse import urlsplit

from eal_actors.kernel.clock import REAL_TIME, Clock, new_waiter
from eal_actors.kernel.errors import EALError, NotReadyError, PluginError

_T = TypeVar("_T")

_FIRST_TRY_S: Final = 0.2
_LONGEST_TRY_S: Final = 5.0
_WRITE_TIMEOUT_S: Final = 0.2
_SERIAL_WRITE_TIMEOUT_S: Final = 1.0
"""Pyserial looks at the time after the bytes have gone: on a busy machine a shorter one would lose a sound port."""
_CONNECT_TIMEOUT_S: Final = 5.0
_JOIN_S: Final = 1.0
_PEER_LOST_S: Final = 10  # a peer that has lost its power says nothing; this long until TCP gives it up
_BROKEN: Final = (OSError, termios.error)  # pyserial's errors are among the first; the second is none of them


class BytePort(Protocol):
    """What a driver uses of a serial port. Pyserial's ports have it, with a `timeout` of 0, and simulated ones."""

    @property
    def in_waiting(self) -> int:
        """How many bytes can be read."""
        ...

    def read(self, size: int = 1) -> bytes:
        """Return what has arrived, at most so many bytes; does not wait."""
        ...

    def write(self, data: bytes) -> int | None:
        """Send bytes."""
        ...

    def reset_input_buffer(self) -> None:
        """Forget what has arrived."""
        ...

    def close(self) -> None:
        """Let go of the port."""
        ...


class ReopeningPort:
    """A BytePort that comes back when its device does.

    A port that breaks is closed and opened again, in a thread of its own, 0.2 s later and then less and less often,
    up to every 5 s. These are real seconds whatever the fleet's clock does, because hardware returns in real time.
    Errors of the framework that a port raises, as simulated ports do, pass through and break nothing.

    Args:
        open_port: opens the port. An OSError means that the device is absent, a PluginError a wrong configuration.
        clock: the fleet's clock, which need not stand still while a port is opened.
        name: what messages call it, such as `/dev/ttyUSB0`.

    Attributes:
        openings: how often it has been opened. When it changes, the device may be another, or have been switched
            off and on: greet it anew.

    Thread: any. Two writes never interleave, and nothing waits but a write, at most as long as the port itself does.
    """

    def __init__(self, open_port: Callable[[], BytePort], clock: Clock, name: str) -> None:
        self.name: Final = name
        self.openings = 0
        self._open_port = open_port
        self._clock = clock
        self._lock = threading.Lock()
        self._port: BytePort | None = None
        self._reason = f"{name} has not been opened"
        self._next_try_s: float | None = None
        self._is_closed = False
        self._is_open = threading.Event()
        self._end_of_wait = new_waiter()
        self._reopener: threading.Thread | None = None

    def why_not_ready(self) -> str | None:
        """Return why it cannot be used now and when it is tried again; None while it is open. Does not wait."""
        reason, next_try_s = self._reason, self._next_try_s
        if self._port is not None:
            return None
        if next_try_s is None:
            return reason
        return f"{reason}; next try in {max(next_try_s - REAL_TIME.now(), 0.0):.1f} s"

    def open(self) -> None:
        """Open it for the first time. An absent device is no error: it is tried again, see `why_not_ready`.

        Raises:
            NotReadyError: it has been closed.
            PluginError: the configuration is wrong.

        Thread: blocks the caller while the port is opened, which may take seconds through a network. In lock step the
            fleet's time stands still meanwhile: whoever connects drivers one after the other must not be late.
        """
        try:
            port = self._open_port()
        except _BROKEN as error:
            with self._lock:
                self._retry(f"cannot open {self.name}: {_why(error)}", None)
            return
        if not self._take(port):
            raise NotReadyError(self._reason)

    def wait_until_open(self, timeout_s: float) -> bool:
        """Wait until it is open; return whether it is.

        Args:
            timeout_s: real seconds to wait at most.

        Thread: blocks the caller.
        """
        with self._clock.outside():
            return self._is_open.wait(timeout_s)

    @property
    def in_waiting(self) -> int:
        """How many bytes can be read; raises as `use` does."""
        return self.use(lambda port: port.in_waiting)

    def read(self, size: int = 4096) -> bytes:
        """Return what has arrived, at most so many bytes; never waits; raises as `use` does."""
        return bytes(self.use(lambda port: port.read(size)))

    def write(self, data: bytes) -> int:
        """Send bytes, and return how many were taken; raises as `use` does."""
        taken = self.use(lambda port: port.write(data))
        return len(data) if taken is None else taken

    def reset_input_buffer(self) -> None:
        """Forget what has arrived; raises as `use` does."""
        self.use(lambda port: port.reset_input_buffer())

    def use(self, action: Callable[[BytePort], _T]) -> _T:
        """Do something with the open port while nobody else does, such as several reads, or a change of its speed.

        Raises:
            NotReadyError: it is not open, or it broke, and is being opened again.
        """
        with self._lock:
            port = self._port
            if port is None:
                raise NotReadyError(self.why_not_ready() or self._reason)
            try:
                return action(port)
            except EALError:  # before OSError, which some of them are
                raise
            except _BROKEN as error:
                self._port = None
                self._is_open.clear()
                self._retry(f"{self.name} was lost: {_why(error)}", port)
                raise NotReadyError(self.why_not_ready() or self._reason) from error

    def close(self) -> None:
        """Let go of it for good; harmless if it is closed. Thread: blocks the caller for a second at most."""
        with self._lock:
            self._is_closed = True
            port, self._port = self._port, None
            self._reason, self._next_try_s = f"{self.name} is closed", None
            self._is_open.clear()
            reopener = self._reopener
        REAL_TIME.wake(self._end_of_wait)
        if port is not None:
            _let_go(port)
        if reopener is not None:
            with self._clock.outside():
                reopener.join(_JOIN_S)  # it may be connecting, and ends by itself then

    def _retry(self, reason: str, broken: BytePort | None) -> None:
        """Begin to open it again. Thread: holds the lock."""
        if self._is_closed:
            return
        self._reason, self._next_try_s = reason, REAL_TIME.now() + _FIRST_TRY_S
        self._reopener = threading.Thread(
            target=self._reopen, args=(broken,), name=f"reopening {self.name}", daemon=True
        )
        self._reopener.start()

    def _reopen(self, broken: BytePort | None) -> None:
        """Try until it is open or closed for good. Thread: its own."""
        if broken is not None:
            _drop_output(broken)
            _let_go(broken)  # here, because a serial port that is stuck waits for its device when it is closed
        delay_s = _FIRST_TRY_S
        while not REAL_TIME.wait(self._end_of_wait, delay_s):
            try:
                port = self._open_port()
            except Exception as error:  # noqa: BLE001  # whatever an opener raises, it is tried again
                delay_s = min(2 * delay_s, _LONGEST_TRY_S)
                with self._lock:
                    if self._is_closed:
                        return
                    self._reason = f"cannot open {self.name}: {_why(error)}"
                    self._next_try_s = REAL_TIME.now() + delay_s
            else:
                self._take(port)
                return

    def _take(self, port: BytePort) -> bool:
        """Use a port from now on, unless it has been closed meanwhile."""
        with self._lock:
            if not self._is_closed:
                self._port, self._next_try_s = port, None
                self.openings += 1
                self._is_open.set()
                return True
        _let_go(port)
        return False


def _let_go(port: BytePort) -> None:
    with contextlib.suppress(*_BROKEN):
        port.close()


def _drop_output(port: BytePort) -> None:
    """Drop what a broken port has not sent: a device must not carry out, when it is back, what it was told before."""
    if (drop := getattr(port, "reset_output_buffer", None)) is not None:
        with contextlib.suppress(*_BROKEN):
            drop()


def _why(error: BaseException) -> str:
    """Return an error's reason in the operating system's words, if it is known; pyserial wraps it, with the name."""
    if isinstance(error, termios.error):
        return str(error.args[-1]).lower()
    found: BaseException | None = error
    while found is not None:
        if isinstance(found, OSError) and found.errno is not None:
            reason = os.strerror(found.errno) if found.errno > 0 else str(found.strerror)
            return reason.lower()
        found = found.__cause__ or (None if found.__suppress_context__ else found.__context__)
    return str(error) or type(error).__name__


def open_serial(
    url: str,
    *,
    baudrate: int,
    bytesize: int = 8,
    parity: str = "N",
    stopbits: float = 1,
    exclusive: bool = True,
) -> BytePort:
    """Open a serial port whose reads never wait.

    Args:
        url: a device path, or a URL that pyserial knows, such as `socket://host:port` or `rfc2217://host:port`.
        baudrate: bits a second.
        bytesize: data bits: 5 to 8.
        parity: `N`, `E`, `O`, `M` or `S`.
        stopbits: 1, 1.5 or 2.
        exclusive: let nobody else open a device, who would take bytes away.

    Raises:
        PluginError: no device can be behind that configuration.
        OSError: it cannot be opened at present.

    Thread: blocks the caller; a connection through a network may take seconds.
    """
    if url.startswith("socket:"):
        return open_tcp(*_host_and_port(url))
    if "://" not in url and (path := Path(url)).exists() and not path.is_char_device():
        raise PluginError(f"{url} is no serial port, but a {'folder' if path.is_dir() else 'file'}")
    import serial  # who has no serial port need not load it

    try:
        port: BytePort = serial.serial_for_url(
            url,
            baudrate=baudrate,
            bytesize=bytesize,
            parity=parity,
            stopbits=stopbits,
            timeout=0,
            write_timeout=_SERIAL_WRITE_TIMEOUT_S,
            exclusive=exclusive,
        )
    except ValueError as error:
        raise PluginError(f"serial port {url}: {error}") from error
    except termios.error as error:
        raise OSError(*error.args) from error
    return port


def _host_and_port(url: str) -> tuple[str, int]:
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise PluginError(f"serial port {url}: {error}") from error
    if parts.scheme != "socket" or not host or port is None:
        raise PluginError(f"serial port {url}: wanted is socket://host:port")
    return host, port


def open_tcp(host: str, port: int, timeout_s: float = _CONNECT_TIMEOUT_S) -> TcpPort:
    """Connect to a TCP server.

    Args:
        host: its name or address.
        port: 1 to 65535.
        timeout_s: real seconds to wait for it at most.

    Raises:
        OSError: it does not answer, refuses, or has no such name.

    Thread: blocks the caller for `timeout_s` at most, and as long as it takes to look up the name.
    """
    return TcpPort(socket.create_connection((host, port), timeout_s))


class TcpPort:
    """A TCP connection as a BytePort: what is written goes out at once, and a peer that is gone is noticed.

    Args:
        connection: a connected socket, which it owns from now on.
    """

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # a stop must not wait for more bytes
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in (
            ("TCP_KEEPIDLE", _PEER_LOST_S // 2),
            ("TCP_KEEPINTVL", 1),
            ("TCP_KEEPCNT", _PEER_LOST_S // 2),
            ("TCP_USER_TIMEOUT", _PEER_LOST_S * 1000),
        ):
            if hasattr(socket, option):  # not every system has them
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)

    def fileno(self) -> int:
        """Return the descriptor, for a `select` that waits for bytes."""
        return self._socket.fileno()

    @property
    def in_waiting(self) -> int:
        """See BytePort."""
        waiting: int = struct.unpack("i", fcntl.ioctl(self._socket, termios.FIONREAD, bytes(4)))[0]
        return waiting

    def read(self, size: int = 1) -> bytes:
        """See BytePort; raises OSError when the connection has ended."""
        try:
            data = self._socket.recv(size)
        except BlockingIOError:
            return b""
        if not data and size > 0:
            raise ConnectionError("the other end has closed the connection")
        return data

    def write(self, data: bytes) -> int:
        """Send bytes, all or as many as go out within 0.2 s, after which it raises OSError."""
        sent, end_s = 0, REAL_TIME.now() + _WRITE_TIMEOUT_S
        while (sent := sent + self.write_some(data[sent:])) < len(data):
            left_s = end_s - REAL_TIME.now()
            if left_s <= 0 or not select.select([], [self._socket], [], left_s)[1]:
                raise TimeoutError(f"took only {sent} of {len(data)} bytes in {_WRITE_TIMEOUT_S} s")
        return len(data)

    def write_some(self, data: bytes) -> int:
        """Send as many bytes as go out at once, and return how many those were; 0 for none."""
        try:
            return self._socket.send(data)
        except BlockingIOError:
            return 0

    def reset_input_buffer(self) -> None:
        """See BytePort."""
        while self.read(65536):
            pass

    def reset_output_buffer(self) -> None:
        """Drop, when it is closed, what the other end has not taken."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))

    def close(self) -> None:
        """See BytePort."""
        self._socket.close()


class UdpPort:
    """A UDP socket as a BytePort: a read or a write is one datagram. It never blocks.

    An absent peer is no error, because datagrams may be lost.

    Args:
        host: name or address of the peer; datagrams from others are ignored.
        port: its port.
        local_port: the local port; 0 for any.

    Raises:
        OSError: the host is unknown or unreachable, or the local port is in use.

    Thread: the constructor blocks while the name is looked up.
    """

    def __init__(self, host: str, port: int, local_port: int = 0) -> None:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(family, kind, protocol)
        try:
            self._socket.setblocking(False)
            self._socket.bind(("", local_port))
            self._socket.connect(address)
        except BaseException:
            self._socket.close()
            raise

    @property
    def in_waiting(self) -> int:
        """Return 1 if a datagram can be read, else 0."""
        return len(select.select([self._socket], [], [], 0)[0])

    def read(self, size: int = 65536) -> bytes:  # noqa: ARG002  # a datagram is read as a whole
        """Return the next datagram; empty for none."""
        try:
            return self._socket.recv(65536)
        except (BlockingIOError, ConnectionRefusedError):  # the peer of an earlier datagram did not listen
            return b""

    def write(self, data: bytes) -> int:
        """Send one datagram; return 0 if it could not be sent now."""
        try:
            return self._socket.send(data)
        except (BlockingIOError, ConnectionRefusedError):  # the second reports an earlier datagram
            return 0

    def reset_input_buffer(self) -> None:
        """Discard all received datagrams."""
        while self.in_waiting:
            self.read()

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
