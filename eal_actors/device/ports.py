"""Ports that reopen when their device comes back, and the byte ports that drivers read and write.

A driver opens its port through a `ReopeningPort`. While the device is absent, the driver's resources are *not ready*
(`Resource.not_ready`), so they are not restarted; when it is back, they continue.
"""

from __future__ import annotations

import contextlib
import os
import select
import threading
from collections.abc import Callable
from typing import Any, Final, Generic, Protocol, TypeVar

from eal_actors.kernel.clock import REAL_TIME, Clock, new_waiter
from eal_actors.kernel.errors import EALError, NotReadyError
from eal_actors.kernel.posix import TerminalError

_T = TypeVar("_T")
_D = TypeVar("_D")

_FIRST_TRY_S: Final = 0.2
_LONGEST_TRY_S: Final = 5.0
_JOIN_S: Final = 1.0
_POLL_PEER_CLOSED: Final = getattr(select, "POLLRDHUP", 0)
_BROKEN: Final = (OSError, TerminalError)  # pyserial's errors are among the first; the second is none of them


class BytePort(Protocol):
    """The part of a serial port that drivers use; simulated ports and pyserial's, with a `timeout` of 0, have it."""

    @property
    def in_waiting(self) -> int:
        """The number of bytes that can be read."""

    def read(self, size: int = 1) -> bytes:
        """Return the received bytes, at most `size`; does not wait."""

    def write(self, data: bytes) -> int | None:
        """Send bytes."""

    def reset_input_buffer(self) -> None:
        """Discard the received bytes."""

    def close(self) -> None:
        """Close the port."""


class ReopeningDevice(Generic[_D]):
    """A device that reopens when it comes back: a port, or the object of a vendor's library that owns one.

    A device that breaks is closed and reopened, in a thread of its own, after 0.2 s and then at growing intervals of up
    to 5 s. These are real seconds whatever the fleet's clock does, because hardware returns in real time. EALErrors of
    a device, as simulated ports raise, are passed on and do not break it.

    Args:
        open_port: opens the device, which needs nothing but a method `close`. An OSError means that it is absent, a
            PluginError a wrong configuration.
        clock: the fleet's clock, whose time may advance while a port is opened.
        name: its name in messages, such as `/dev/ttyUSB0`.

    `openings` counts how often it has been opened. When it changes, the device may be another one, or have been
    switched off and on: initialise it again. Thread: any. Uses never interleave. Only a use blocks, at most as long as
    the device itself does.
    """

    def __init__(self, open_port: Callable[[], _D], clock: Clock, name: str) -> None:
        self.name: Final = name
        self.openings = 0
        self._open_port = open_port
        self._clock = clock
        self._lock = threading.Lock()
        self._user: int | None = None
        self._port: _D | None = None
        self._reason = f"{name} has not been opened"
        self._next_try_s: float | None = None
        self._is_closed = False
        self._is_open = threading.Event()
        self._end_of_wait = new_waiter()
        self._reopener: threading.Thread | None = None

    def why_not_ready(self) -> str | None:
        """Return why it cannot be used now and the time of the next try; None while it is open. Does not wait.

        It notices by itself that a serial cable was unplugged or a TCP peer has gone, also while nobody reads.
        """
        if (port := self._port) is not None and _is_gone(port):
            self._notice_loss(port)
        reason, next_try_s = self._reason, self._next_try_s
        if self._port is not None:
            return None
        if next_try_s is None:
            return reason
        return f"{reason}; next try in {max(next_try_s - REAL_TIME.now(), 0.0):.1f} s"

    def open(self) -> None:
        """Open it for the first time. An absent device is no error: it is retried, see `why_not_ready`.

        Raises:
            NotReadyError: it has been closed.
            PluginError: the configuration is wrong.

        Thread: blocks the caller while the port is opened, which may take seconds through a network. In lock step the
            fleet's time stands still meanwhile, so that drivers that connect one after the other are not late.
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
        """Wait until it is open, for some real seconds at most; return whether it is. Thread: blocks the caller."""
        with self._clock.outside():
            return self._is_open.wait(timeout_s)

    def use(self, action: Callable[[_D], _T]) -> _T:
        """Use the open device exclusively, for several reads or a change of its speed.

        The action may use this object too, such as its `read` and `write`.

        Raises NotReadyError if it is not open, or it broke and is being reopened.
        """
        if self._user == threading.get_ident() and self._port is not None:
            return action(self._port)  # within an action, which has the lock and handles its errors
        with self._lock:
            if (port := self._port) is None:
                raise NotReadyError(self.why_not_ready() or self._reason)
            self._user = threading.get_ident()
            try:
                return action(port)
            except EALError:  # before OSError, which some of them are
                raise
            except _BROKEN as error:
                self._lose(port, _why(error))
                raise NotReadyError(self.why_not_ready() or self._reason) from error
            finally:
                self._user = None

    def close(self) -> None:
        """Close it for good; harmless if it is closed. Thread: blocks the caller for a second at most."""
        with self._lock:
            self._is_closed = True
            port, self._port = self._port, None
            self._reason, self._next_try_s = f"{self.name} is closed", None
            self._is_open.clear()
            reopener = self._reopener
        REAL_TIME.wake(self._end_of_wait)
        if port is not None:
            _close_quietly(port)
        if reopener is not None:
            with self._clock.outside():
                reopener.join(_JOIN_S)  # it may be connecting, and then ends by itself

    def _notice_loss(self, port: _D) -> None:
        """Reopen a device that is gone, unless it is in use: then its user notices. Does not wait."""
        if self._lock.acquire(blocking=False):
            try:
                if self._port is port and _is_gone(port):  # a user may have taken the last bytes meanwhile
                    self._lose(port, "unplugged, or closed at the other end")
            finally:
                self._lock.release()

    def _lose(self, port: _D, reason: str) -> None:
        """Reopen a broken device. Thread: holds the lock."""
        self._port = None
        self._is_open.clear()
        self._retry(f"{self.name} was lost: {reason}", port)

    def _retry(self, reason: str, broken: _D | None) -> None:
        """Start to reopen it. Thread: holds the lock."""
        if self._is_closed:
            return
        self._reason, self._next_try_s = reason, REAL_TIME.now() + _FIRST_TRY_S
        self._reopener = threading.Thread(
            target=self._reopen, args=(broken,), name=f"reopening {self.name}", daemon=True
        )
        self._reopener.start()

    def _reopen(self, broken: _D | None) -> None:
        """Retry until it is open or closed for good. Thread: its own."""
        if broken is not None:
            if (drop := getattr(broken, "reset_output_buffer", None)) is not None:
                with contextlib.suppress(*_BROKEN):
                    drop()  # a device that comes back must not execute old commands
            _close_quietly(broken)  # here, because closing a stuck serial port waits for its device
        delay_s = _FIRST_TRY_S
        while not REAL_TIME.wait(self._end_of_wait, delay_s):
            try:
                port = self._open_port()
            except Exception as error:  # noqa: BLE001  # any error of an opener is retried
                delay_s = min(2 * delay_s, _LONGEST_TRY_S)
                with self._lock:
                    if self._is_closed:
                        return
                    self._reason = f"cannot open {self.name}: {_why(error)}"
                    self._next_try_s = REAL_TIME.now() + delay_s
            else:
                self._take(port)
                return

    def _take(self, port: _D) -> bool:
        """Use a port from now on; close it and return False if this one has been closed meanwhile."""
        with self._lock:
            if not self._is_closed:
                self._port, self._next_try_s = port, None
                self.openings += 1
                self._is_open.set()
                return True
        _close_quietly(port)
        return False


class ReopeningPort(ReopeningDevice[BytePort]):
    """A BytePort that reopens when its device comes back; see ReopeningDevice."""

    @property
    def in_waiting(self) -> int:
        """The number of bytes that can be read; raises as `use` does."""
        return self.use(lambda port: port.in_waiting)

    def read(self, size: int = 4096) -> bytes:
        """Return the received bytes, at most `size`; never waits; raises as `use` does."""
        return bytes(self.use(lambda port: port.read(size)))

    def write(self, data: bytes) -> int:
        """Send bytes and return how many were accepted; raises as `use` does."""
        taken = self.use(lambda port: port.write(data))
        return len(data) if taken is None else taken

    def reset_input_buffer(self) -> None:
        """Discard the received bytes; raises as `use` does."""
        self.use(lambda port: port.reset_input_buffer())


def _is_gone(port: Any) -> bool:
    """Return whether the descriptor of a device, if it has one, reports that the other end has gone. Does not wait."""
    try:
        descriptor = port.fileno()
        poller = select.poll()
        poller.register(descriptor, _POLL_PEER_CLOSED)
        if not (events := poller.poll(0)):
            return False
        hung_up = bool(events[0][1] & select.POLLHUP)
        closed = bool(events[0][1] & _POLL_PEER_CLOSED) and not port.in_waiting  # its last bytes are read first
    except (AttributeError, OSError, ValueError, TypeError):  # it has no descriptor, or is closed already
        return False
    return hung_up or closed


def _close_quietly(port: Any) -> None:
    with contextlib.suppress(*_BROKEN):
        port.close()


def _why(error: BaseException) -> str:
    """Return the operating system's message of an error, if there is one; pyserial wraps it, with the port's name."""
    if isinstance(error, TerminalError):
        return str(error.args[-1]).lower()
    found = system_error(error)
    if found is None or found.errno is None:
        return str(error) or type(error).__name__
    message = os.strerror(found.errno) if found.errno > 0 else str(found.strerror)
    return "; ".join([message.lower(), *getattr(error, "__notes__", ())])


def system_error(error: BaseException | None) -> OSError | None:
    """Return the operating system's error in a chain of errors; None if there is none."""
    while error is not None and not (isinstance(error, OSError) and error.errno is not None):
        error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    return error
