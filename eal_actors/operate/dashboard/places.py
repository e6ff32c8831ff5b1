"""Places: bounds the connections of a web server, so that no stranger can keep an operator out.

A connection waits until its browser has said hello, and only waiting connections are ever closed for others. A newcomer
always finds a place: the connection that has waited longest gives way, of the newcomer's own address if that has its
share, else of the address with the most. So connections that are held open cost their own address only, and one that
sends its request at once needs its place for a round trip.
"""

from __future__ import annotations

import contextlib
import ipaddress
import socket
from collections import Counter
from collections.abc import Mapping
from typing import Any, Final

from eal_actors.kernel.clock import REAL_TIME, Clock

MAX_CONNECTIONS: Final = 192
MAX_PER_ADDRESS: Final = 64
WAIT_S: Final = 5.0
"""Real seconds for a handshake and the headers of the first request."""
ANSWER_S: Final = 30.0
"""Real seconds for a browser to read the answer to a request, or to say hello."""


class Place:
    """The place of one connection. Thread: the web server's."""

    def __init__(self, opened: socket.socket, source: str, clock: Clock) -> None:
        self.source: Final = source
        self._opened = opened
        self._clock = clock
        self.is_waiting = True
        self.renewed_s = clock.now()
        self.end_s = self.renewed_s + WAIT_S

    @property
    def is_free(self) -> bool:
        """Whether the connection is closed."""
        return self._opened.fileno() < 0

    def renew(self) -> None:
        """Give the connection more time, because it has completed a request."""
        self.renewed_s = self._clock.now()
        self.end_s = self.renewed_s + ANSWER_S

    def keep(self) -> None:
        """Keep the connection open until its browser leaves."""
        self.is_waiting = False

    def abort(self) -> None:
        """Close the connection without waiting for its browser."""
        with contextlib.suppress(OSError):  # closed already
            self._opened.shutdown(socket.SHUT_RDWR)
        self.is_waiting = False  # its place is free when the server has closed its end as well


class Places:
    """The places of a web server. Thread: the web server's."""

    def __init__(self, clock: Clock = REAL_TIME) -> None:
        self._clock = clock
        self._places: list[Place] = []

    def take(self, opened: socket.socket, address: str) -> Place | None:
        """Return a place for a new connection, in place of another's if necessary; None if all are kept."""
        self._places = [place for place in self._places if not place.is_free]
        source = source_of(address)
        waiting = [place for place in self._places if place.is_waiting]
        if sum(place.source == source for place in self._places) >= MAX_PER_ADDRESS:
            waiting = [place for place in waiting if place.source == source]
        elif len(self._places) >= MAX_CONNECTIONS:
            shares = Counter(place.source for place in waiting)
            crowd = max(shares, key=lambda each: (shares[each], each == source), default="")
            waiting = [place for place in waiting if place.source == crowd]
        else:
            return self._add(opened, source)
        if not waiting:
            return None
        oldest = min(waiting, key=lambda place: place.renewed_s)
        oldest.abort()
        self._places.remove(oldest)
        return self._add(opened, source)

    def _add(self, opened: socket.socket, source: str) -> Place:
        place = Place(opened, source, self._clock)
        self._places.append(place)
        return place

    def expire(self) -> None:
        """Close the connections that have waited too long."""
        now_s = self._clock.now()
        for place in self._places:
            if place.is_waiting and now_s >= place.end_s:
                place.abort()


def source_of(address: str) -> str:
    """Return the group that shares its places: an IPv4 address, or the network of 64 bits of an IPv6 address."""
    parsed = ipaddress.ip_address(address.partition("%")[0])
    if isinstance(parsed, ipaddress.IPv4Address):
        return str(parsed)
    mapped = parsed.ipv4_mapped
    return str(mapped or ipaddress.ip_network((parsed, 64), strict=False))


def place_of(scope: Mapping[str, Any]) -> Place | None:
    """Return the place of a request's connection; None without a server, as in tests of the application alone."""
    place: Place | None = scope.get("state", {}).get("place")
    return place
