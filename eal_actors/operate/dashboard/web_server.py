"""WebServer: uvicorn in its own thread, whose end never waits for browsers."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
import threading
from collections.abc import Callable, Coroutine
from functools import partial
from pathlib import Path
from typing import Final

import uvicorn
from starlette.types import ASGIApp
from typing_extensions import override
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.protocol import State

from eal_actors.kernel.errors import UnavailableError, error_text, file_error
from eal_actors.kernel.log import get_logger
from eal_actors.operate.dashboard.limits import MAX_MESSAGE_BYTES
from eal_actors.operate.dashboard.notifier import Notifier
from eal_actors.operate.dashboard.places import WAIT_S, Place, Places

_GRACE_S: Final = 0.5  # real seconds for browsers to close their connections at the end
_START_S: Final = 10.0
_PING_S: Final = 5.0
_ACCEPT_AGAIN_S: Final = 0.1
_BACKLOG: Final = 512
_ENDING: Final = (State.CLOSING, State.CLOSED)
_HEADER_BYTES: Final = 16 * 1024
_SEND_BUFFER_BYTES: Final = 256 * 1024
"""The system's buffer for a browser that does not read. A small buffer holds fewer outdated updates."""


def listen_at(host: str, port: int) -> socket.socket:
    """Return a socket that listens at an address of this machine; port 0 is any free port.

    Raises ConfigError if the port is in use, or the address is not this machine's.
    """
    opened = None
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        opened = socket.socket(family, kind, protocol)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)  # connections inherit it
        opened.bind(address)
        opened.listen(_BACKLOG)
        opened.setblocking(False)
    except OSError as error:
        if opened is not None:
            opened.close()
        raise file_error(f"{host}:{port}", f"cannot listen there: {error.strerror}") from None
    return opened


def tls_context(certificate: Path, key: Path) -> ssl.SSLContext:
    """Return the context of an HTTPS server.

    Raises ConfigError if the files are missing, or are no certificate and its key.
    """
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_cert_chain(certificate, key)
    except OSError as error:  # ssl.SSLError too
        raise file_error(certificate, f"cannot be used for HTTPS: {error.strerror or error}") from error
    return context


class _Server(uvicorn.Server):
    """Gives each connection a place, attaches the notifier to its loop, and waits for no browser at its end."""

    def __init__(
        self,
        config: uvicorn.Config,
        listener: socket.socket,
        notifier: Notifier,
        tls: ssl.SSLContext | None,
        follow_credentials: Callable[[], Coroutine[None, None, None]],
    ) -> None:
        super().__init__(config)
        self._tls = tls
        self._follow_credentials = follow_credentials
        self._listener = listener
        self._notifier = notifier
        self._places = Places()
        self._tasks: list[asyncio.Task[None]] = []
        self._opening: set[asyncio.Task[None]] = set()
        self.is_up = threading.Event()

    @override
    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup([])  # its own way to accept would neither bound connections nor end handshakes soon
        self._notifier.attach(asyncio.get_running_loop())
        self._tasks = [asyncio.create_task(self._accept()), asyncio.create_task(self._follow_credentials())]
        self.is_up.set()

    async def _accept(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(0)  # requests are read between two newcomers, before a burst of these takes their place
            try:
                opened, address = await loop.sock_accept(self._listener)
            except OSError as error:  # such as: no descriptors are left
                get_logger().warning("a browser could not be accepted", reason=error_text(error))
                await asyncio.sleep(_ACCEPT_AGAIN_S)
                continue
            if (place := self._places.take(opened, address[0])) is None:
                opened.close()
                continue
            task = asyncio.create_task(self._open(opened, place))
            self._opening.add(task)
            task.add_done_callback(self._opening.discard)
            task.add_done_callback(partial(_close_unopened, opened))

    async def _open(self, opened: socket.socket, place: Place) -> None:
        """Hand a connection over to its protocol, which gives the place to the application with each request."""

        def make_protocol() -> asyncio.Protocol:
            return H11Protocol(self.config, self.server_state, {"place": place})

        limit_s = None if self._tls is None else WAIT_S
        with contextlib.suppress(OSError):  # the browser has left, or speaks no TLS
            await asyncio.get_running_loop().connect_accepted_socket(
                make_protocol, opened, ssl=self._tls, ssl_handshake_timeout=limit_s
            )

    @override
    async def on_tick(self, counter: int) -> bool:
        self._places.expire()
        return await super().on_tick(counter)

    @override
    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._notifier.attach(None)
        for task in (*self._tasks, *self._opening):
            task.cancel()
        self._abort_closing()
        asyncio.get_running_loop().call_later(_GRACE_S, self._abort_rest)
        await super().shutdown(sockets)

    def _abort_closing(self) -> None:
        """End websockets that are just being closed: uvicorn's own shutdown raises for them, and leaves the others."""
        for connection in list(self.server_state.connections):
            if isinstance(connection, WebSocketsSansIOProtocol) and connection.conn.state in _ENDING:
                connection.transport.abort()
                self.server_state.connections.discard(connection)

    def _abort_rest(self) -> None:
        for connection in list(self.server_state.connections):
            if connection.transport is not None:
                connection.transport.abort()


def _close_unopened(opened: socket.socket, task: asyncio.Task[None]) -> None:
    if task.cancelled():  # the server ended before the task began
        opened.close()


class WebServer:
    """Serves an application between `start` and `close`, which closes the listening socket."""

    def __init__(
        self,
        app: ASGIApp,
        listener: socket.socket,
        notifier: Notifier,
        tls: ssl.SSLContext | None,
        follow_credentials: Callable[[], Coroutine[None, None, None]],
    ) -> None:
        self._listener = listener
        config = uvicorn.Config(
            app,
            http=H11Protocol,
            ws="websockets-sansio",
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
            h11_max_incomplete_event_size=_HEADER_BYTES,
            timeout_graceful_shutdown=2,
        )
        self._server = _Server(config, listener, notifier, tls, follow_credentials)
        self._thread = threading.Thread(target=self._serve, name="dashboard web server", daemon=True)

    def start(self) -> None:
        """Start to serve; UnavailableError if the server did not start. Thread: blocks the caller until it serves."""
        self._thread.start()
        if not self._server.is_up.wait(_START_S) or not self._server.started:
            self.close()
            raise UnavailableError("the dashboard's web server did not start")

    def _serve(self) -> None:
        try:
            self._server.run()
        finally:
            self._listener.close()
            self._server.is_up.set()

    def close(self) -> None:
        """Stop serving. Thread: blocks the caller for at most a few seconds."""
        self._server.should_exit = True
        if self._thread.ident is not None:
            self._thread.join()
        self._listener.close()
