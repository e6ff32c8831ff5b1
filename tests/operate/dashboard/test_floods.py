"""An operator opens the page and stops the robots while others connect again and again from the same address."""

from __future__ import annotations

import socket
import ssl
import statistics
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest

from eal_actors.kernel.clock import REAL_TIME
from eal_actors.managers.keys.certificates import certificate_file, key_file, make_authority, make_certificate
from eal_actors.operate.dashboard import Dashboard, tls_context
from eal_actors.operate.dashboard.places import MAX_PER_ADDRESS
from tests.net.rig import process
from tests.operate.dashboard.flooding import KINDS
from tests.operate.dashboard.rig import WAIT_S, counting_fleet, open_dashboard, page_of

TOKEN = "the-token-of-these-tests"  # noqa: S105  # fixed, because it is part of test names
FLOODERS = 2
STOPS = 50


@contextmanager
def busy(dashboard: Dashboard) -> Iterator[None]:
    """Keep the web server's thread busy for a `with` block, so that connections pile up in the kernel."""
    is_busy, may_continue = threading.Event(), threading.Event()
    loop = dashboard.app_state.notifier._loop
    assert loop is not None

    def wait() -> None:
        is_busy.set()
        may_continue.wait(WAIT_S)

    loop.call_soon_threadsafe(wait)
    assert is_busy.wait(WAIT_S)
    try:
        yield
    finally:
        may_continue.set()


def test_a_request_that_came_before_a_burst_of_connections_is_answered(tmp_path: Path) -> None:
    with (
        counting_fleet(tmp_path, "one").connect() as fleet,
        open_dashboard(fleet, TOKEN) as dashboard,
        ExitStack() as stack,
    ):

        def connect() -> socket.socket:
            return stack.enter_context(socket.create_connection(("127.0.0.1", dashboard.port), WAIT_S))

        with busy(dashboard):
            operator = connect()
            operator.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n")
            strangers = [connect() for _ in range(4 * MAX_PER_ADDRESS)]
        assert operator.recv(15) == b"HTTP/1.1 200 OK"
        assert strangers


def secured(folder: Path) -> tuple[ssl.SSLContext, ssl.SSLContext]:
    """Return the contexts of an HTTPS server and of a browser that trusts it."""
    make_authority(folder, "f")
    make_certificate(folder, "dashboard", ["127.0.0.1"])
    served = tls_context(certificate_file(folder, "dashboard"), key_file(folder, "dashboard"))
    return served, ssl.create_default_context(cafile=certificate_file(folder, "ca"))


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("kind", KINDS)
def test_pages_open_and_stops_work_in_a_flood_of_connections(tmp_path: Path, kind: str) -> None:
    served, trusting = secured(tmp_path / "keys") if kind == "tls" else (None, None)
    options: dict[str, Any] = {"ssl": trusting} if trusting else {}
    times_s = []
    with (
        counting_fleet(tmp_path, "one").connect() as fleet,
        open_dashboard(fleet, TOKEN, tls=served) as dashboard,
        ExitStack() as flooders,
    ):
        program = ["-m", "tests.operate.dashboard.flooding", str(dashboard.port), kind]
        for _ in range(FLOODERS):
            flooders.enter_context(process(program, tmp_path))
        for _ in range(STOPS):
            begin_s = REAL_TIME.now()
            with page_of(dashboard, TOKEN, open_timeout=WAIT_S, **options) as page:
                assert page.ask(do="stop")["confirmed"] == ["one"]
            with urlopen(dashboard.url, timeout=WAIT_S, context=trusting) as answer:  # noqa: S310  # its own address
                assert b"<title>" in answer.read()
            times_s.append(REAL_TIME.now() - begin_s)
    figures = f"{STOPS} of {STOPS}, median {statistics.median(times_s):.2f} s, longest {max(times_s):.2f} s"
    print(f"{kind}: {figures}")  # noqa: T201  # of the long form
