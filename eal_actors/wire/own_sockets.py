"""The sockets of this process that the network engine has opened: the engine says little about them itself.

Every socket here is a duplicate. To close it does not close the engine's, but what is set or shut down takes effect on
both.
"""

from __future__ import annotations

import contextlib
import os
import socket
import stat
from collections.abc import Container, Iterator
from pathlib import Path
from typing import Final, NamedTuple

from eal_actors.wire.security.packet_filter import plain_address

OPEN_FILES: Final = Path("/proc/self/fd")
"""The descriptors of this process; other systems have no such folder, and show no sockets."""
_NAME_SERVER_PORT: Final = 53
_CLOSED_PORT: Final = 1
_TABLES: Final = Path("/proc/self/net/tcp"), Path("/proc/self/net/tcp6")


class Link(NamedTuple):
    """The ends of a TCP connection of this process; the peer is empty while nobody has answered, and after the end."""

    port: int
    peer: str
    peer_port: int


def link_of(end: socket.socket) -> Link:
    """Return the ends of a connection."""
    port = end.getsockname()[1]
    try:
        peer = end.getpeername()
    except OSError:  # it is not connected
        return Link(port, "", 0)
    return Link(port, plain_address(peer[0]), peer[1])


def connections() -> Iterator[tuple[Link, socket.socket]]:
    """Yield the TCP connections of this process, with their sockets; these are closed afterwards."""
    for end in tcp_sockets():
        with end:
            if not is_listening(end):
                yield link_of(end), end


def tcp_sockets() -> Iterator[socket.socket]:
    """Yield a duplicate of each TCP socket of this process, to be closed."""
    return _sockets(socket.SOCK_STREAM)


def _sockets(kind: socket.SocketKind) -> Iterator[socket.socket]:
    seen = set()
    for file in OPEN_FILES.iterdir() if OPEN_FILES.is_dir() else ():
        with contextlib.suppress(OSError):  # it was closed meanwhile, or no descriptor is free
            status = os.fstat(int(file.name))
            if not stat.S_ISSOCK(status.st_mode) or status.st_ino in seen:
                continue
            seen.add(status.st_ino)
            end = socket.socket(fileno=os.dup(int(file.name)))
            if end.family in (socket.AF_INET, socket.AF_INET6) and end.type == kind:
                yield end
            else:
                end.close()


def refuse_lookups() -> None:
    """Let each question of this process to a name server fail, as if the server refused it.

    The C library asks each server twice, for 5 s each. It waits on if its socket is shut down; so the socket is
    connected to a closed port of this machine, which refuses an empty message.
    """
    for end in _sockets(socket.SOCK_DGRAM):
        with end, contextlib.suppress(OSError):  # it is not connected, or has been refused
            if end.getpeername()[1] == _NAME_SERVER_PORT:
                end.connect((end.getsockname()[0], _CLOSED_PORT))
                end.send(b"")


def sockets_to(ports: Container[int]) -> Iterator[socket.socket]:
    """Yield a duplicate of each TCP socket of this process that has dialled one of some ports, answered or not.

    Source: the kernel's Documentation/networking/proc_net_tcp.rst.
    """
    dialled: set[int] = set()
    for table in _TABLES:
        with contextlib.suppress(OSError):  # this kernel has no IPv6
            rows = (line.split() for line in table.read_text(encoding="ascii").splitlines()[1:])
            dialled.update(int(row[9]) for row in rows if int(row[2].rpartition(":")[2], 16) in ports)
    for end in tcp_sockets():
        if os.fstat(end.fileno()).st_ino in dialled:
            yield end
        else:
            end.close()


def is_listening(end: socket.socket) -> bool:
    """Return whether a socket accepts connections."""
    return bool(end.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN))
