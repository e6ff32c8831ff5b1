"""The web server: uvicorn in a thread of its own, which ends when it is told to, whatever its browsers do."""

from __future__ import annotations

import asyncio
import socket
import threading
from typing import Any, Final

import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from eal_actors.kernel.errors import ConfigError, Problem, UnavailableError
from eal_actors.operate.dashboard.bell import Bell
from eal_actors.operate.dashboard.limits import MAX_BROWSERS, MAX_MESSAGE_BYTES

_GRACE_S: Final = 0.5
"""Real seconds in which browsers may take their leave."""
_START_S: Final = 10.0
_PING_S: Final = 5.0
_BACKLOG: Final = 64
_SEND_BUFFER_BYTES: Final = 256 * 1024
"""What the system may keep for a browser that does not read: the less, the newer is what a slow one gets."""


def listen_at(host: str, port: int) -> socket.socket:
    """Return a socket that listens.

    Args:
        host: a name or address of this machine.
        port: 0 for any that is free.

    Raises:
        ConfigError: the port is in use, or this machine has no such address.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        opened = socket.socket(family, kind, protocol)
    except OSError as error:
        raise ConfigError([Problem(f"{host}:{port}", 0, 0, "", f"cannot listen there: {error.strerror}")]) from None
    try:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)  # of each connection too
        opened.bind(address)
        opened.listen(_BACKLOG)
    except OSError as error:
        opened.close()
        raise ConfigError([Problem(f"{host}:{port}", 0, 0, "", f"cannot listen there: {error.strerror}")]) from None
    return opened


class _Protocol(WebSocketsSansIOProtocol):
    """Lets the application cut off a browser whose buffers are full, which an orderly close would wait for."""

    def handle_connect(self, event: Any) -> None:
        super().handle_connect(event)
        scope: Any = getattr(self, "scope", None)
        if scope is not None:  # the application's task begins after this
            scope["state"]["abort"] = self.transport.abort


class _Server(uvicorn.Server):
    """Tells when it has started, and does not wait for browsers that do not answer at the end."""

    def __init__(self, config: uvicorn.Config, bell: Bell) -> None:
        super().__init__(config)
        self._bell = bell
        self.is_up = threading.Event()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self._bell.hang(asyncio.get_running_loop())
        self.is_up.set()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._bell.hang(None)
        asyncio.get_running_loop().call_later(_GRACE_S, self._abort_rest)
        await super().shutdown(sockets)

    def _abort_rest(self) -> None:
        for connection in list(self.server_state.connections):
            if connection.transport is not None:
                connection.transport.abort()


class WebServer:
    """Serves an application between `start` and `close`.

    Args:
        app: the application.
        listener: where it listens; closed at the end.
        bell: rings in the server's loop while that runs.
    """

    def __init__(self, app: ASGIApp, listener: socket.socket, bell: Bell) -> None:
        self._listener = listener
        config = uvicorn.Config(
            app,
            http="h11",
            ws=_Protocol,
            ws_max_size=MAX_MESSAGE_BYTES,
            ws_ping_interval=_PING_S,
            ws_ping_timeout=_PING_S,
            ws_per_message_deflate=False,
            lifespan="off",
            log_config=None,
            log_level="critical",
            access_log=False,
            proxy_headers=False,
            server_header=False,
            limit_concurrency=4 * MAX_BROWSERS,
            timeout_graceful_shutdown=2,
        )
        self._server = _Server(config, bell)
        self._thread = threading.Thread(target=self._serve, name="dashboard web server", daemon=True)

    def start(self) -> None:
        """Begin to serve.

        Raises:
            UnavailableError: the server did not start.

        Thread: blocks the caller until it serves.
        """
        self._thread.start()
        if not self._server.is_up.wait(_START_S) or not self._server.started:
            self.close()
            raise UnavailableError("the dashboard's web server did not start")

    def _serve(self) -> None:
        try:
            self._server.run(sockets=[self._listener])
        finally:
            self._listener.close()
            self._server.is_up.set()

    def close(self) -> None:
        """End. Thread: blocks the caller until the thread has ended, at most for some seconds."""
        self._server.should_exit = True
        if self._thread.ident is not None:
            self._thread.join()
        self._listener.close()
