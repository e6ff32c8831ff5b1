"""A flood of new connections to a dashboard, as a program of its own: `python -m ... PORT KIND`, until it is killed."""

from __future__ import annotations

import contextlib
import socket
import ssl
import sys
from collections import deque
from itertools import cycle

HELD = 100
"""Connections that each flooder holds; it closes the oldest for a new one."""
WAIT_S = 2.0
KINDS = ("silent", "half", "get", "upgrade", "mixed", "tls")


def client_hello() -> bytes:
    """Return the first message of a TLS handshake."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    outgoing = ssl.MemoryBIO()
    with contextlib.suppress(ssl.SSLWantReadError):
        context.wrap_bio(ssl.MemoryBIO(), outgoing, server_hostname="localhost").do_handshake()
    return outgoing.read()


def messages(kind: str, port: int) -> list[bytes]:
    """Return what the connections of a kind of flood send, in turn."""
    start = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n"
    upgrade = (
        f"GET /ws HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}\r\nConnection: Upgrade\r\n"
        "Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    ).encode()
    post = b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1000000\r\n\r\n{"
    return {
        "silent": [b""],
        "half": [start],
        "get": [start + b"\r\n"],
        "upgrade": [upgrade],
        "mixed": [b"", start, start + b"\r\n", upgrade, post],
        "tls": [client_hello()],
    }[kind]


def flood(port: int, kind: str) -> None:
    """Connect again and again, for ever."""
    held: deque[socket.socket] = deque()
    for message in cycle(messages(kind, port)):
        with contextlib.suppress(OSError):
            peer = socket.create_connection(("127.0.0.1", port), WAIT_S)
            held.append(peer)
            peer.sendall(message)
        if len(held) > HELD:
            held.popleft().close()


if __name__ == "__main__":
    flood(int(sys.argv[1]), sys.argv[2])
