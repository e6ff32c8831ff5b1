"""Bell: wakes what waits in an event loop, from threads that must not wait for it."""

from __future__ import annotations

import asyncio
import contextlib
import threading


class Bell:
    """Rung by any thread; everybody in the loop who listens is woken once for all rings since.

    Thread: `ring` any, and it never blocks; the rest is for the loop's thread.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._is_rung = False
        self._listeners: set[asyncio.Event] = set()

    def hang(self, loop: asyncio.AbstractEventLoop | None) -> None:
        """Ring in this loop from now on; None for nowhere."""
        with self._lock:
            self._loop = loop

    def ring(self) -> None:
        """Wake all who listen."""
        with self._lock:
            if self._is_rung or self._loop is None:
                return
            with contextlib.suppress(RuntimeError):  # the loop has just been closed
                self._loop.call_soon_threadsafe(self._spread)
                self._is_rung = True

    def _spread(self) -> None:
        with self._lock:
            self._is_rung = False
        for event in self._listeners:
            event.set()

    def listen(self) -> asyncio.Event:
        """Return an event that each ring sets, until `leave`."""
        event = asyncio.Event()
        self._listeners.add(event)
        return event

    def leave(self, event: asyncio.Event) -> None:
        """Set it no more."""
        self._listeners.discard(event)
