"""Pyserial's ports; those of this machine are locked for this program alone, and deliver received bytes at once.

`flock` keeps out programs that ask for it, as those on pyserial do; `TIOCEXCL` keeps out all others but those of root.
The terminal keeps `TIOCEXCL` as long as anybody has it open, such as the emulator at a pseudo-terminal, so a port takes
it back when it closes.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import Any

import serial
from typing_extensions import override

from eal_actors.kernel.posix import HAS_TERMINALS, fcntl, termios


class ExclusiveSerial(serial.Serial):  # type: ignore[misc]  # pyserial has no types
    """A serial port of this machine."""

    @override
    def open(self) -> None:
        super().open()
        if self.exclusive and HAS_TERMINALS:
            fcntl.ioctl(self.fd, termios.TIOCEXCL)
        with contextlib.suppress(ValueError, AttributeError):  # no adapter that holds bytes back, or another system
            self.set_low_latency_mode(True)

    @override
    def close(self) -> None:
        if self.is_open and self.exclusive and HAS_TERMINALS:
            with contextlib.suppress(OSError):  # it is unplugged
                fcntl.ioctl(self.fd, termios.TIOCNXCL)
        super().close()


def new_port(url: str, settings: Mapping[str, Any]) -> Any:
    """Return a port of pyserial that is not open yet; ValueError if a setting, or the kind of URL, is invalid."""
    if url.startswith("rfc2217:"):  # pyserial has no time-out of a write there, but one of 5 s of its socket
        settings = {**settings, "write_timeout": None}
    if "://" in url:
        return serial.serial_for_url(url, do_not_open=True, **settings)
    port = ExclusiveSerial(**settings)
    port.port = url
    return port
