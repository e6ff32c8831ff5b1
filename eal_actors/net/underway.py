"""UnderWay: the commands that a robot carries out for controllers, and the queries that wait for their ends."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from eal_actors.actors.call import Call
from eal_actors.net.wire import CallId

if TYPE_CHECKING:
    import zenoh


@dataclass(eq=False, slots=True)
class Running:
    """A command under way.

    Attributes:
        call_id: which it is.
        key: of its method, on which it is answered.
        query: what waits for the answer; None once that was given.
        call: the call to the resource.
        since_s: when it came, in real time.
    """

    call_id: CallId
    key: str
    query: zenoh.Query | None
    call: Call[Any]
    since_s: float


class UnderWay:
    """The commands under way on one robot. Each query is handed out once. Thread: any."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: dict[CallId, Running] = {}

    def add(self, running: Running) -> None:
        """Take in a command that has been passed on to its resource."""
        with self._lock:
            self._running[running.call_id] = running

    def end(self, running: Running) -> zenoh.Query | None:
        """Let go of a command that has ended; returns the query that still waits for its end."""
        with self._lock:
            self._running.pop(running.call_id, None)
            query, running.query = running.query, None
        return query

    def take_long(self, since_s: float) -> list[tuple[Running, zenoh.Query]]:
        """Return the commands that came at that time or before, with the queries that still wait for them."""
        if not self._running:  # as it mostly is, and as is asked often
            return []
        taken = []
        with self._lock:
            for running in self._running.values():
                query = running.query
                if query is not None and running.since_s <= since_s:
                    running.query = None
                    taken.append((running, query))
        return taken

    def ids(self) -> list[CallId]:
        """Return which commands are under way."""
        with self._lock:
            return list(self._running)

    def cancel(self, call_id: CallId) -> None:
        """Give up a command; does nothing if it is not under way."""
        with self._lock:
            running = self._running.get(call_id)
        if running is not None:
            running.call.cancel()
