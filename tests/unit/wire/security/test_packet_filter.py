"""Packet filters on listening sockets of the loopback interface, whose many addresses stand for other machines."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from eal_actors.wire.security.packet_filter import (
    MAX_ADDRESSES,
    PacketRule,
    filter_packets,
    pass_packets,
    plain_address,
)

DROPPED_S = 0.2
"""The kernel sends a dropped packet again after a second, so this suffices on any machine."""
PASSED_S = 30.0
OTHERS_V4 = [f"10.0.0.{number}" for number in range(MAX_ADDRESSES - 1)]
OTHERS_V6 = [f"fd00::{number}" for number in range(MAX_ADDRESSES - 1)]


@contextmanager
def listening(host: str) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as listener:
        listener.bind((host, 0))
        listener.listen()
        yield listener


def pass_only(listener: socket.socket, *addresses: str) -> None:
    filter_packets(listener, PacketRule(addresses, are_dropped=False))


def connects(listener: socket.socket, source: str, wait_s: float) -> bool:
    with socket.socket(socket.AF_INET6 if ":" in source else socket.AF_INET) as peer:
        peer.bind((source, 0))
        peer.settimeout(wait_s)
        try:
            peer.connect(("::1" if ":" in source else "127.0.0.1", listener.getsockname()[1]))
        except TimeoutError:
            return False
        return True


@pytest.mark.parametrize("host", ["127.0.0.1", "::"])
def test_only_the_given_addresses_get_through(host: str) -> None:
    with listening(host) as listener:
        pass_only(listener)
        assert not connects(listener, "127.0.0.1", DROPPED_S)
        pass_only(listener, "127.0.0.1")
        assert connects(listener, "127.0.0.1", PASSED_S)
        assert not connects(listener, "127.0.0.2", DROPPED_S)
        pass_only(listener, *OTHERS_V4, *OTHERS_V6, "127.0.0.3")
        assert connects(listener, "127.0.0.3", PASSED_S)
        assert not connects(listener, "127.0.0.2", DROPPED_S)
        pass_packets(listener)
        assert connects(listener, "127.0.0.2", PASSED_S)


def test_addresses_of_version_six_get_through() -> None:
    with listening("::") as listener:
        pass_only(listener, *OTHERS_V4, "127.0.0.1", *OTHERS_V6)
        assert not connects(listener, "::1", DROPPED_S)
        pass_only(listener, *OTHERS_V4, *OTHERS_V6, "::1")
        assert connects(listener, "::1", PASSED_S)
        assert not connects(listener, "127.0.0.1", DROPPED_S)


def test_only_the_given_addresses_are_dropped() -> None:
    with listening("::") as listener:
        filter_packets(listener, PacketRule(("127.0.0.2", "::1"), are_dropped=True))
        assert connects(listener, "127.0.0.1", PASSED_S)
        assert not connects(listener, "127.0.0.2", DROPPED_S)
        assert not connects(listener, "::1", DROPPED_S)


@pytest.mark.parametrize(
    ("text", "plain"), [("10.0.0.1", "10.0.0.1"), ("::ffff:10.0.0.1", "10.0.0.1"), ("fe80::1%eth0", "fe80::1")]
)
def test_an_address_has_one_form(text: str, plain: str) -> None:
    assert plain_address(text) == plain
