"""Modules that only POSIX systems have. Import them from here: a system without one fails only where it is used."""

from __future__ import annotations

import getpass
import os
from functools import cache
from importlib import import_module
from typing import IO, TYPE_CHECKING, Any, Final, NoReturn

if TYPE_CHECKING:
    import fcntl
    import grp
    import pty
    import resource
    import termios
    import tty

    TerminalError = termios.error
else:

    class _MissingModule:
        """In place of a module that this system has not."""

        def __init__(self, name: str) -> None:
            self._name = name

        def __getattr__(self, attribute: str) -> NoReturn:
            raise AttributeError(f"{self._name}.{attribute}: this system has no module {self._name!r}")

    def _optional(name: str) -> Any:
        try:
            return import_module(name)
        except ModuleNotFoundError:
            return _MissingModule(name)

    class _NeverRaisedError(Exception):
        """In place of errors that this system does not raise."""

    fcntl, grp, pty, resource, termios, tty = map(_optional, ("fcntl", "grp", "pty", "resource", "termios", "tty"))
    TerminalError = getattr(termios, "error", _NeverRaisedError)

HAS_TERMINALS: Final = hasattr(termios, "TIOCEXCL")
"""Whether serial ports and terminals are those of POSIX."""

HAS_LIMITS: Final = hasattr(resource, "getrlimit")
"""Whether a process has limits of its resources."""

__all__ = [
    "HAS_LIMITS",
    "HAS_TERMINALS",
    "TerminalError",
    "fcntl",
    "grp",
    "lock",
    "pty",
    "resource",
    "termios",
    "tty",
    "user_name",
]


def lock(stream: IO[Any]) -> None:
    """Lock an open file against other processes until it is closed; a system without such locks locks nothing.

    Raises:
        BlockingIOError: another process holds it.
        OSError: its file system has no locks.
    """
    if hasattr(fcntl, "flock"):
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)


@cache
def user_name() -> str:
    """Return the name of the user of this process; a number if it has none, as in some containers."""
    try:
        return getpass.getuser()
    except (ImportError, KeyError, OSError):  # by Python's version and the system
        return str(os.getuid()) if hasattr(os, "getuid") else "somebody"
