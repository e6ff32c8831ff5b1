"""Notifier: wakes tasks of an event loop from other threads, which must not wait for the loop."""

from __future__ import annotations

import asyncio
import contextlib
import threading


class Notifier:
    """Wakes every subscriber once for all notifications since it last woke up.

    Thread: `notify` any, and it never blocks; the rest is for the loop's thread.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._is_pending = False
        self._subscribers: set[asyncio.Event] = set()

    def attach(self, loop: asyncio.AbstractEventLoop | None) -> None:
        """Notify subscribers in this loop from now on; None for no loop."""
        with self._lock:
            self._loop = loop

    def notify(self) -> None:
        """Wake the subscribers."""
        with self._lock:
            if self._is_pending or self._loop is None:
                return
            with contextlib.suppress(RuntimeError):  # the loop has just been closed
                self._loop.call_soon_threadsafe(self._wake)
                self._is_pending = True

    def _wake(self) -> None:
        with self._lock:
            self._is_pending = False
        for event in self._subscribers:
            event.set()

    def subscribe(self) -> asyncio.Event:
        """Return an event that each notification sets, until `unsubscribe`."""
        event = asyncio.Event()
        self._subscribers.add(event)
        return event

    def unsubscribe(self, event: asyncio.Event) -> None:
        """Remove a subscriber."""
        self._subscribers.discard(event)
