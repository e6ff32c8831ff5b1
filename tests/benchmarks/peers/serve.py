"""The robots' process of one peer: `python -m tests.benchmarks.peers.serve NAME PORT`; ends with its standard input."""

from __future__ import annotations

import asyncio
import os
import sys
import threading
from collections.abc import Awaitable, Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from tests.benchmarks.peers import engine, others, tcp

if TYPE_CHECKING:
    import zenoh


def _up() -> None:
    """Tell that everything listens, and end with the standard input."""

    def watch() -> None:
        sys.stdin.read()
        os._exit(0)

    sys.stdout.write("up\n")
    sys.stdout.flush()
    threading.Thread(target=watch, daemon=True).start()


def _tcp(port: int) -> None:
    server = tcp.TcpServer(port)
    _up()
    server.serve_forever()


def _zenoh(serve: Callable[[int], zenoh.Session], port: int) -> None:
    session = serve(port)
    _up()
    threading.Event().wait()
    session.close()  # type: ignore[no-untyped-call]  # zenoh's stubs say nothing of it


def _pyro(port: int) -> None:
    daemon = others.pyro_daemon(port)
    _up()
    daemon.requestLoop()


async def _xoscar(port: int) -> None:
    pool = await others.serve_xoscar(port)
    _up()
    await pool.join()


async def _viam(port: int) -> None:
    serving = asyncio.create_task(others.serve_viam(port))
    while True:
        try:
            _, writer = await asyncio.open_connection("127.0.0.1", port)
        except OSError:
            await asyncio.sleep(0.05)
        else:
            writer.close()
            break
    _up()
    await serving


_BLOCKING: dict[str, Callable[[int], None]] = {
    "raw TCP": _tcp,
    "bare zenoh": partial(_zenoh, engine.serve_zenoh),
    "zenoh's floor": partial(_zenoh, engine.serve_publications),
    "Pyro5": _pyro,
}
_AWAITED: dict[str, Callable[[int], Awaitable[Any]]] = {"xoscar": _xoscar, "viam-sdk": _viam}


def main() -> None:
    """Serve until the standard input ends."""
    name, port = sys.argv[1], int(sys.argv[2])
    if name in _BLOCKING:
        _BLOCKING[name](port)
    else:
        asyncio.run(_AWAITED[name](port))  # type: ignore[arg-type]  # they are coroutines


if __name__ == "__main__":
    main()
