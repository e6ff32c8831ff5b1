"""Strangers who hold connections cannot keep an operator from the page and from STOP."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from urllib.request import urlopen

import pytest

from eal_actors.operate.dashboard import Dashboard
from eal_actors.operate.dashboard.limits import MAX_BROWSERS
from eal_actors.operate.dashboard.places import (
    ANSWER_S,
    MAX_CONNECTIONS,
    MAX_PER_ADDRESS,
    WAIT_S,
    Place,
    Places,
    source_of,
)
from tests.manual_clock import ManualClock
from tests.operate.dashboard.rig import WAIT_S as TEST_S
from tests.operate.dashboard.rig import counting_fleet, open_dashboard, page_of

TOKEN = "the-token-of-these-tests"  # noqa: S105  # fixed, because it is part of test names
HALF_REQUESTS = (
    b"",
    b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: ",
    b"GET /ws HTTP/1.1\r\nUpgrade: websocket\r\n",
    b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1000000\r\n\r\n{",  # answered, and held after that
)
ATTACKERS = 600


@pytest.fixture
def sockets() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


class TestPlaces:
    """The rules alone, with real sockets and a manual clock."""

    @pytest.fixture
    def clock(self) -> ManualClock:
        return ManualClock()

    @pytest.fixture
    def places(self, clock: ManualClock) -> Places:
        return Places(clock)

    def take(self, places: Places, sockets: ExitStack, address: str) -> tuple[Place | None, socket.socket]:
        ours, theirs = (sockets.enter_context(each) for each in socket.socketpair())
        theirs.setblocking(False)
        return places.take(ours, address), theirs

    def test_the_longest_waiting_connection_of_an_address_gives_way(
        self, places: Places, sockets: ExitStack, clock: ManualClock
    ) -> None:
        first, first_end = self.take(places, sockets, "10.0.0.1")
        assert first is not None
        clock.advance(0.1)
        _, second_end = self.take(places, sockets, "10.0.0.1")
        clock.advance(0.1)
        first.renew()  # so the second has waited longest
        for _ in range(MAX_PER_ADDRESS - 1):
            assert self.take(places, sockets, "10.0.0.1")[0] is not None
        assert second_end.recv(1) == b""
        with pytest.raises(BlockingIOError):
            first_end.recv(1)

    def test_an_address_with_few_connections_takes_the_place_of_one_with_many(
        self, places: Places, sockets: ExitStack
    ) -> None:
        few, few_end = self.take(places, sockets, "10.0.0.9")
        ends = [self.take(places, sockets, f"10.0.1.{n % 4}")[1] for n in range(MAX_CONNECTIONS)]
        assert few is not None
        assert few.is_waiting
        with pytest.raises(BlockingIOError):
            few_end.recv(1)
        assert self.take(places, sockets, "10.0.0.9")[0] is not None
        assert sum(_is_closed(end) for end in ends) == 2

    def test_kept_connections_give_way_to_nobody(self, places: Places, sockets: ExitStack, clock: ManualClock) -> None:
        kept = [self.take(places, sockets, "10.0.0.1") for _ in range(MAX_PER_ADDRESS)]
        for place, _ in kept:
            assert place is not None
            place.keep()
        assert self.take(places, sockets, "10.0.0.1")[0] is None
        assert self.take(places, sockets, "10.0.0.2")[0] is not None
        clock.advance(1000.0)
        places.expire()
        assert not any(_is_closed(end) for _, end in kept)

    def test_a_connection_that_completes_no_request_in_time_is_closed(
        self, places: Places, sockets: ExitStack, clock: ManualClock
    ) -> None:
        _, silent = self.take(places, sockets, "10.0.0.1")
        asking, asking_end = self.take(places, sockets, "10.0.0.1")
        assert asking is not None
        asking.renew()
        clock.advance(WAIT_S)
        places.expire()
        assert _is_closed(silent)
        assert not _is_closed(asking_end)
        clock.advance(ANSWER_S)
        places.expire()
        assert _is_closed(asking_end)

    @pytest.mark.parametrize(
        ("address", "source"),
        [
            ("10.0.0.1", "10.0.0.1"),
            ("::ffff:10.0.0.1", "10.0.0.1"),
            ("2001:db8:1:2:3::4", "2001:db8:1:2::/64"),
            ("fe80::1%eth0", "fe80::/64"),
        ],
    )
    def test_an_ipv6_network_shares_its_places(self, address: str, source: str) -> None:
        assert source_of(address) == source


def _is_closed(end: socket.socket) -> bool:
    try:
        return end.recv(1) == b""
    except BlockingIOError:
        return False


@contextmanager
def attacked(dashboard: Dashboard) -> Iterator[list[socket.socket]]:
    """Hold 600 connections that never complete a request."""
    with ExitStack() as stack:
        opened = []
        for number in range(ATTACKERS):
            end = stack.enter_context(socket.create_connection(("127.0.0.1", dashboard.port), TEST_S))
            end.sendall(HALF_REQUESTS[number % len(HALF_REQUESTS)])
            opened.append(end)
        yield opened


def test_an_operator_opens_the_page_and_stops_the_robots_under_half_requests(tmp_path: Path) -> None:
    with (
        counting_fleet(tmp_path, "one").connect() as fleet,
        open_dashboard(fleet, TOKEN) as dashboard,
        attacked(dashboard) as held,
        page_of(dashboard, TOKEN) as page,
    ):
        with urlopen(dashboard.url, timeout=TEST_S) as answer:  # noqa: S310  # its own address
            assert b"<title>" in answer.read()
        assert page.ask(do="stop")["confirmed"] == ["one"]
        for end in held:
            end.settimeout(TEST_S)
            read_to_the_end(end)
        assert page.ask(do="resume")["ok"] is True


def read_to_the_end(end: socket.socket) -> None:
    """Read until the server closes the connection; one that it holds open fails the test by its time-out."""
    with suppress(ConnectionResetError):
        while end.recv(4096):
            pass


@pytest.mark.slow
def test_strangers_who_watch_give_way_to_an_operator(tmp_path: Path) -> None:
    with (
        counting_fleet(tmp_path, "one").connect() as fleet,
        open_dashboard(fleet, TOKEN) as dashboard,
        ExitStack() as stack,
    ):
        for _ in range(MAX_BROWSERS):
            stack.enter_context(page_of(dashboard))
        with page_of(dashboard, TOKEN) as page:
            assert page.ask(do="stop")["confirmed"] == ["one"]
