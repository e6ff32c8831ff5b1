"""AcceptGuard: strangers that only connect must not use up the descriptors of a listening process.

zenoh accepts every connection at once, and takes no bound. Measured with version 1.10: once `accept` fails for want of
a descriptor, its TLS listener no longer looks at the handshakes under way, so none of them ends, and the robot is
unreachable until a restart. Each handshake that fails also costs that listener 0.1 s, in which no other one advances.
The guard prevents both. It shares the listening socket with the engine:

- The queue of connections that wait to be accepted is short. A burst of 500 left 150 handshakes to fail on a busy
  machine, which kept new controllers out for 20 to 34 s; with the short queue it leaves 30 to 60.
- While too many connections have no finished handshake, the kernel drops the packets of new ones from the addresses
  that most of them have (packet_filter), and those that wait are closed. Links that exist are not touched, and refused
  controllers dial again.
- Where that does not suffice, for too many addresses, and while descriptors are short, only addresses that have had a
  link pass, unless strangers share them.
- From three quarters of the descriptors on, new connections are refused. A burst may use up all of them before the
  guard looks; it holds some, and frees them then, so that `accept` works again.

Limits: no new connection gets in from an address that strangers share. From many addresses they keep all out that have
had no link. TCP_DEFER_ACCEPT was tried: silent connections wait in the kernel then, and come in after the attack.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Final

from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.posix import HAS_LIMITS, resource
from eal_actors.wire.engine_exit import start_thread
from eal_actors.wire.own_sockets import OPEN_FILES, connections, is_listening, tcp_sockets
from eal_actors.wire.security.packet_filter import MAX_ADDRESSES, PacketRule, filter_packets, pass_packets

MAX_FILES: Final = 65_536
"""Open files that a listening process asks for, if its hard limit allows them."""
ROBOT_STRANGERS: Final = 24
"""Connections to a robot without a finished handshake at which new ones are refused."""
ROUTER_STRANGERS: Final = 256
"""The same of a router, to which a whole fleet may connect at once."""
_SPARE: Final = 64
_SHARE: Final = 4
"""Part of the bound from which an address is refused, and below which all addresses pass again."""
_QUEUE_SHARE: Final = 12
"""Part of the bound that may wait to be accepted; the kernel asks others to try again after a second."""
_LOOK_S: Final = 0.25
_BUSY_LOOK_S: Final = 0.005
_WARN_EACH_S: Final = 10.0


def raise_file_limit() -> int:
    """Raise the soft limit of open files as far as the hard limit allows, and return it."""
    if not HAS_LIMITS:
        return MAX_FILES
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MAX_FILES if hard == resource.RLIM_INFINITY else min(hard, MAX_FILES)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
        return wanted
    return MAX_FILES if soft == resource.RLIM_INFINITY else soft


def descriptor_warnings() -> list[str]:
    """Return a warning if more than three quarters of this process's file descriptors are in use."""
    if not HAS_LIMITS:
        return []
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        used = _count_files()
    except FileNotFoundError:  # another system
        return []
    except OSError:  # looking takes one
        used = soft
    if soft == resource.RLIM_INFINITY or used <= _reserved_from(soft):
        return []
    return [f"{used} of {soft} file descriptors are in use; new connections are refused: raise `ulimit -n`"]


def _reserved_from(limit: int) -> int:
    """Return the number of descriptors in use from which strangers get no more."""
    return limit - limit // 4


@contextmanager
def guarding(ports: Iterable[int], most: int, linked: Callable[[], list[str]]) -> Iterator[None]:
    """Guard this process's TCP sockets that listen at some ports, for the length of a `with` block.

    At most `most` connections may lack a finished handshake; `linked` returns the IP addresses of those that have one.
    """
    served = frozenset(ports)
    listeners = []
    for end in tcp_sockets():
        if is_listening(end) and end.getsockname()[1] in served:
            listeners.append(end)
        else:
            end.close()
    if not listeners:
        yield
        return

    def connected() -> Counter[str]:
        return Counter(link.peer for link, _ in connections() if link.port in served)

    guard = AcceptGuard(listeners, raise_file_limit(), most, connected, linked)
    try:
        yield
    finally:
        guard.close()


def _count_files() -> int:
    return sum(1 for _ in OPEN_FILES.iterdir())


class AcceptGuard:
    """Closes new connections while descriptors are short. Thread: one of its own.

    The listeners are duplicates, which it closes with itself. `file_limit` is the limit of this process's open files,
    `most` that of connections that are no links yet. `connected` returns the IP addresses of all connections, `linked`
    those of the connections that are links.
    """

    def __init__(
        self,
        listeners: list[socket.socket],
        file_limit: int,
        most: int,
        connected: Callable[[], Counter[str]],
        linked: Callable[[], list[str]],
    ) -> None:
        self._listeners = listeners
        self._most = most
        self._connected = connected
        self._linked = linked
        self._known: dict[str, None] = {}  # the addresses that have had links, the latest last
        self._strangers: Counter[str] = Counter()
        self._rule: PacketRule | None = None  # while the filter is on
        self._has_waiting = False
        self._usual_files = _count_files()
        self._most_files = _reserved_from(file_limit)
        self._spare: list[int] = []
        self._take_spare()
        self._poll = select.epoll()
        self._warn_at_s = 0.0
        self._ends = False
        for listener in listeners:
            listener.listen(most // _QUEUE_SHARE)
            self._poll.register(listener, select.EPOLLIN | select.EPOLLET)
        self._thread = start_thread(self._run, "eal-net-guard")

    def close(self) -> None:
        """End the guard. Thread: blocks the caller for a moment."""
        self._ends = True
        self._thread.join()
        self._poll.close()
        for listener in self._listeners:
            listener.close()
        for spare in self._spare:
            os.close(spare)

    def _run(self) -> None:
        while not self._ends:
            rule = self._needed_rule(self._learn())
            if rule is not None:
                self._shut(rule)
            elif self._rule is not None:
                self._open()
            self._poll.poll(_LOOK_S if rule is None else _BUSY_LOOK_S)

    def _learn(self) -> list[str]:
        """Remember the addresses of links, and return them."""
        linked = self._linked()
        for address in set(linked):
            self._known.pop(address, None)
            self._known[address] = None
        while len(self._known) > MAX_ADDRESSES:
            del self._known[next(iter(self._known))]
        return linked

    def _needed_rule(self, linked: list[str]) -> PacketRule | None:
        """Return which packets are to be dropped; None if there is no crowd."""
        share = self._most // _SHARE
        most = self._most if self._rule is None else share  # so that it opens seldom
        try:
            files = _count_files()
            if files <= self._usual_files + most:  # the usual case, which costs little
                return None
            self._strangers = self._connected() - Counter(linked)
            if files <= self._most_files:
                total = self._strangers.total()
                if total <= most:
                    return None
                most_common = self._strangers.most_common(MAX_ADDRESSES)
                crowds = [it for it, count in most_common if it and count >= share]
                has_many_sources = self._rule is not None and not self._rule.are_dropped
                if total - sum(self._strangers[it] for it in crowds) <= (share if has_many_sources else self._most):
                    return PacketRule(tuple(sorted(crowds)), are_dropped=True)
        except OSError:  # no descriptor is free
            pass
        return PacketRule(tuple(sorted(it for it in self._known if self._strangers[it] < share)), are_dropped=False)

    def _shut(self, rule: PacketRule) -> None:
        if rule != self._rule:
            for listener in self._listeners:
                filter_packets(listener, rule)
            if self._rule is None:
                self._has_waiting = True
                for _ in range(len(self._spare) // 2):  # `accept` fails while no descriptor is free
                    os.close(self._spare.pop())
            self._rule = rule
        if self._has_waiting:
            self._refuse_waiting()
        now_s = REAL_TIME.now()
        if now_s >= self._warn_at_s:
            self._warn_at_s = now_s + _WARN_EACH_S
            message = "too many connections: new ones are refused until others end"
            addresses = {"refused" if rule.are_dropped else "passing": list(rule.addresses)}
            get_logger().warning(message, strangers=self._strangers.total(), **addresses)

    def _open(self) -> None:
        for listener in self._listeners:
            pass_packets(listener)
        self._rule = None
        self._take_spare()

    def _take_spare(self) -> None:
        with contextlib.suppress(OSError):
            while len(self._spare) < _SPARE:
                self._spare.append(os.open(os.devnull, os.O_RDONLY))

    def _refuse_waiting(self) -> None:
        """Close the connections that wait to be accepted: they came before the filter."""
        self._has_waiting = False
        for listener in self._listeners:
            try:
                while not self._ends:
                    listener.accept()[0].close()
            except BlockingIOError:  # no more wait
                pass
            except OSError:  # the engine has taken the last descriptor
                self._has_waiting = True
