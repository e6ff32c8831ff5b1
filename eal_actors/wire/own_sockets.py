"""The TCP sockets of this process, which the network engine has opened: the engine says little about them itself.

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
from typing import Final

OPEN_FILES: Final = Path("/proc/self/fd")
"""The descriptors of this process; other systems have no such folder, and show no sockets."""
_TABLES: Final = Path("/proc/self/net/tcp"), Path("/proc/self/net/tcp6")


def tcp_sockets() -> Iterator[socket.socket]:
    """Yield a duplicate of each TCP socket of this process, to be closed."""
    seen = set()
    for file in OPEN_FILES.iterdir() if OPEN_FILES.is_dir() else ():
        with contextlib.suppress(OSError):  # it was closed meanwhile, or no descriptor is free
            status = os.fstat(int(file.name))
            if not stat.S_ISSOCK(status.st_mode) or status.st_ino in seen:
                continue
            seen.add(status.st_ino)
            end = socket.socket(fileno=os.dup(int(file.name)))
            if end.family in (socket.AF_INET, socket.AF_INET6) and end.type == socket.SOCK_STREAM:
                yield end
            else:
                end.close()


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
