"""Keys that control a run on a terminal: pause, single steps, stop."""

from __future__ import annotations

import atexit
import os
import select
import sys
import threading
from typing import Any, Final, Self

from eal_actors.kernel.log import get_logger
from eal_actors.kernel.posix import HAS_TERMINALS, TerminalError, termios, tty
from eal_actors.scenario import Run

LEGEND: Final = "space: pause   s: step   q: stop"
_JOIN_S: Final = 2.0


def keys_work() -> bool:
    """Return whether the program reads keys: stdin is a terminal, and the program is in its foreground."""
    if not HAS_TERMINALS or not sys.stdin.isatty():
        return False
    try:
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except OSError:
        return False


class RunKeys:
    """Key handling for the length of a `with` block; the terminal's settings are restored in every case.

    It does nothing where the program cannot read keys.
    """

    def __init__(self, run: Run) -> None:
        self._run = run
        self._fd = -1
        self._before: Any = None
        self._wake: tuple[int, int] | None = None
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        if not keys_work():
            return self
        self._fd = sys.stdin.fileno()
        try:
            self._before = termios.tcgetattr(self._fd)
            atexit.register(self._restore)
            tty.setcbreak(self._fd)  # keeps Ctrl-C
        except TerminalError as error:
            get_logger().debug("keys do not work on this terminal", reason=str(error))
            self._restore()
            return self
        self._wake = os.pipe()
        self._thread = threading.Thread(target=self._listen, name="keys", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_exc_info: object) -> None:
        if self._wake is not None and self._thread is not None:
            os.write(self._wake[1], b".")
            self._thread.join(_JOIN_S)
            for end in self._wake:
                os.close(end)
            self._wake = None
        self._restore()

    def _restore(self) -> None:
        before, self._before = self._before, None
        if before is not None:
            atexit.unregister(self._restore)
            try:
                termios.tcsetattr(self._fd, termios.TCSADRAIN, before)
            except TerminalError:  # the terminal was closed
                return

    def _listen(self) -> None:
        wake = self._wake[0] if self._wake is not None else -1
        while True:
            ready, _, _ = select.select([self._fd, wake], [], [])
            if wake in ready:
                return
            try:
                key = os.read(self._fd, 1)
            except OSError:  # the terminal was closed
                return
            if not key:
                return
            self._handle_key(key)

    def _handle_key(self, key: bytes) -> None:
        if key == b" ":
            (self._run.resume if self._run.is_paused else self._run.pause)()
        elif key in b"sS":
            self._run.step()
        elif key in b"qQ":
            self._run.abort("stopped by the key q")
