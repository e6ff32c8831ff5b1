"""LinkWatch: ends links that the engine does not read, and notices an engine that finishes no handshake.

zenoh 1.10 bounds a handshake by a time-out, which can strike after the link is registered and before its reader
starts. Both ends count such a link as good: it sends, nobody reads, and nobody watches its lease. The same peer gets
no second link, so it is never answered again. With a time-out about as long as a handshake takes, 4 of 16 links ended
so on one processor (tests/net/test_link_watch.py); an emulated board that needed two seconds was deaf after two of five
starts. The session's time-outs are long for that reason, and this watch ends the links that it happens to
nevertheless: the engine's sender notices, and the other end dials again.

A listening engine that is out of order, as it is while no descriptor is free, neither finishes nor ends handshakes.
Each connection becomes a link or is closed within the engine's two time-outs of 20 s; one that stays much longer shows
that the session must be opened again.

The engine also keeps declared keys and subscriptions, without a bound: 20,000 keys of 2 kB, which access
control does not look at, took a robot from 83 to 152 MB. So while memory is short, the watch ends the link that has
sent the most, and the engine frees what came over it.

Limits: TCP and TLS on Linux; systems without /proc show no sockets, so nothing is watched there. A QUIC link shows no
unread bytes.
"""

from __future__ import annotations

import array
import contextlib
import socket
import struct
import threading
from collections.abc import Callable, Container, Iterable, Iterator
from contextlib import contextmanager
from typing import Final

from eal_actors.kernel.clock import REAL_TIME, new_waiter
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.memory import MemoryRoom
from eal_actors.kernel.posix import fcntl, termios
from eal_actors.managers.network_model import parse_endpoint
from eal_actors.wire.engine_exit import start_thread
from eal_actors.wire.own_sockets import Link, connections, link_of, sockets_to

LOOK_S: Final = 1.0
"""Least real seconds between two looks. Looks are counted, since this process may have been frozen between two."""
_SHARE: Final = 0.01
"""Part of the time that the looks take at most; one takes 0.3 ms with one link, 53 ms with both ends of a thousand."""
_MAX_PAUSE_S: Final = 10.0
_MEMORY_LOOK_S: Final = 0.05
"""The same between two looks at the memory of a listening process, which take 0.1 ms."""
_RELIEF_S: Final = 0.2
"""Time in which the engine frees what came over a link that was ended."""
_MUCH_BYTES: Final = 256 * 1024
"""Bytes that a link has brought, below which it does not fill the memory."""
DEAF_LOOKS: Final = 10
"""Looks in a row that find the same bytes unread before a link is ended."""
STUCK_LOOKS: Final = 90
"""Looks in a row that find a connection without a handshake before the engine counts as out of order."""
_BYTES_RECEIVED: Final = 128
"""Offset of `tcpi_bytes_received` in `struct tcp_info`. Source: linux/tcp.h."""


@contextmanager
def watching(
    links: Callable[[], set[Link]], ports: frozenset[int], on_stuck: Callable[[], object] | None
) -> Iterator[None]:
    """Watch a session for the length of a `with` block.

    `links` returns the links of the session, which listens at `ports`. `on_stuck` is called when the engine is out of
    order. Thread: the watch's.
    """
    watch = LinkWatch(links, ports, on_stuck)
    ended = new_waiter()

    def look() -> None:
        pause_s = LOOK_S
        memory = MemoryRoom()
        look_at_s = relieve_at_s = REAL_TIME.now() + pause_s
        while not REAL_TIME.wait(ended, _MEMORY_LOOK_S if ports else pause_s):
            begin_s = REAL_TIME.now()
            try:
                if ports and begin_s >= relieve_at_s and memory.is_short():
                    relieve_at_s = begin_s + _RELIEF_S
                    watch.relieve()
                    memory.free()
                if begin_s >= look_at_s:
                    watch.look()
                    pause_s = min(max(LOOK_S, (REAL_TIME.now() - begin_s) / _SHARE), _MAX_PAUSE_S)
                    look_at_s = begin_s + pause_s
            except OSError as error:  # no descriptor is free
                get_logger().debug("the links cannot be looked at", reason=str(error))

    thread = start_thread(look, "eal-net-links")
    try:
        yield
    finally:
        REAL_TIME.wake(ended)
        if thread is not threading.current_thread():
            thread.join(LOOK_S)


class LinkWatch:
    """Compares the connections of a session at each look with those of the look before; see `watching`."""

    def __init__(
        self, links: Callable[[], set[Link]], ports: frozenset[int], on_stuck: Callable[[], object] | None
    ) -> None:
        self._links = links
        self._ports = ports
        self._on_stuck = on_stuck
        self._unread: dict[Link, tuple[int, int]] = {}
        self._pending: dict[Link, int] = {}

    def look(self) -> None:
        """Look once."""
        links = self._links()
        unread, pending, is_stuck = {}, {}, False
        for link, end in connections():
            if link in links:
                unread[link] = self._judge(link, end)
            elif link.peer and link.port in self._ports:
                pending[link] = looks = self._pending.get(link, 0) + 1
                if looks > STUCK_LOOKS:
                    end.shutdown(socket.SHUT_RDWR)  # the closed session may keep it
                    is_stuck = True
        self._unread, self._pending = unread, pending
        if is_stuck and self._on_stuck is not None:
            self._on_stuck()

    def relieve(self) -> None:
        """End the links that have sent much since the last look, or the one that has sent the most in all."""
        links = self._links()
        sent = {link: _received(end) for link, end in connections() if link in links}
        much = {link for link, total in sent.items() if total - self._unread.get(link, (0, 0))[0] > _MUCH_BYTES}
        if not much and sent:
            worst = max(sent, key=sent.__getitem__)
            much = {worst} if sent[worst] > _MUCH_BYTES else set()
        for link, end in connections():
            if link in much:
                get_logger().warning(
                    "memory is short: a link that has sent much is ended, and the other end connects again",
                    peer=f"{link.peer}:{link.peer_port}",
                    received_bytes=sent[link],
                )
                end.shutdown(socket.SHUT_RDWR)

    def _judge(self, link: Link, end: socket.socket) -> tuple[int, int]:
        """Return how much of a link is read, and how many looks found the same with more to read; end a deaf one."""
        waiting = array.array("i", [0])
        fcntl.ioctl(end, termios.FIONREAD, waiting)
        read = _received(end) - waiting[0]
        before, looks = self._unread.get(link, (read, 0))
        looks = looks + 1 if waiting[0] and read == before else 0
        if looks > DEAF_LOOKS:
            get_logger().warning(
                "the network engine does not read a link; it is ended, and the other end connects again",
                peer=f"{link.peer}:{link.peer_port}",
                unread_bytes=waiting[0],
            )
            end.shutdown(socket.SHUT_RDWR)
            looks = 0
        return read, looks


def _received(end: socket.socket) -> int:
    info = end.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 256)
    received: int = struct.unpack_from("=Q", info, _BYTES_RECEIVED)[0]
    return received


def hang_up(endpoints: Iterable[str], links: Container[Link] = ()) -> None:
    """End the connections to some endpoints that are none of the links: their handshakes are under way.

    The engine would wait for each of them, up to 10 s, and a program that ends would wait for it.
    """
    for end in sockets_to({parse_endpoint(endpoint).port for endpoint in endpoints}):
        with end, contextlib.suppress(OSError):  # it has ended
            if link_of(end) not in links:
                end.shutdown(socket.SHUT_RDWR)
