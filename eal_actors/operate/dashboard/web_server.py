"""WebServer: uvicorn in its own thread, whose end never waits for browsers."""

from __future__ import annotations

import asyncio
import socket
import threading
from typing import Any, Final

import uvicorn
from starlette.types import ASGIApp
from typing_extensions import override
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from eal_actors.kernel.errors import ConfigError, Problem, UnavailableError
from eal_actors.operate.dashboard.limits import MAX_BROWSERS, MAX_MESSAGE_BYTES
from eal_actors.operate.dashboard.notifier import Notifier

_GRACE_S: Final = 0.5
"""Real seconds for browsers to close their connections at the end."""
_START_S: Final = 10.0
_PING_S: Final = 5.0
_BACKLOG: Final = 64
_SEND_BUFFER_BYTES: Final = 256 * 1024
"""The system's buffer for a browser that does not read. A small buffer holds fewer outdated updates."""


def listen_at(host: str, port: int) -> socket.socket:
    """Return a listening socket.

    Args:
        host: a name or address of this machine.
        port: 0 for any free port.

    Raises:
        ConfigError: the port is in use, or the address is not this machine's.
    """
    opened = None
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        opened = socket.socket(family, kind, protocol)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)  # connections inherit it
        opened.bind(address)
        opened.listen(_BACKLOG)
    except OSError as error:
        if opened is not None:
            opened.close()
        raise ConfigError([Problem(f"{host}:{port}", 0, 0, "", f"cannot listen there: {error.strerror}")]) from None
    return opened


class _AbortableProtocol(WebSocketsSansIOProtocol):
    """Gives the application a function that drops a connection whose buffers are full: an orderly close would wait."""

    @override
    def handle_connect(self, event: Any) -> None:
        super().handle_connect(event)
        scope: Any = getattr(self, "scope", None)
        if scope is not None:  # the application's task starts after this
            scope["state"]["abort"] = self.transport.abort


class _Server(uvicorn.Server):
    """Attaches the notifier to its loop, and aborts connections that do not close at the end."""

    def __init__(self, config: uvicorn.Config, notifier: Notifier) -> None:
        super().__init__(config)
        self._notifier = notifier
        self.is_up = threading.Event()

    @override
    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self._notifier.attach(asyncio.get_running_loop())
        self.is_up.set()

    @override
    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._notifier.attach(None)
        asyncio.get_running_loop().call_later(_GRACE_S, self._abort_rest)
        await super().shutdown(sockets)

    def _abort_rest(self) -> None:
        for connection in list(self.server_state.connections):
            if connection.transport is not None:
                connection.transport.abort()


class WebServer:
    """Serves an application between `start` and `close`, which closes the listening socket."""

    def __init__(self, app: ASGIApp, listener: socket.socket, notifier: Notifier) -> None:
        self._listener = listener
        config = uvicorn.Config(
            app,
            http="h11",
            ws=_AbortableProtocol,
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
        self._server = _Server(config, notifier)
        self._thread = threading.Thread(target=self._serve, name="dashboard web server", daemon=True)

    def start(self) -> None:
        """Start to serve.

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
        """Stop serving. Thread: blocks the caller for at most a few seconds."""
        self._server.should_exit = True
        if self._thread.ident is not None:
            self._thread.join()
        self._listener.close()
