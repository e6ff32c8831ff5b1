"""The socket_port plugin with real sockets on this machine."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from eal_actors import Fleet
from eal_actors.actors.handles import ResourceHandle
from eal_actors.kernel.errors import ArgumentError, NotReadyError, PluginError, RobotFailedError, UnavailableError
from eal_actors.managers.config import EALConfigManager
from tests.unit.device.port_rig import WAIT_S, Server, server

__all__ = ["server"]


@contextmanager
def connected(port: int, **settings: Any) -> Iterator[ResourceHandle]:
    plugins = {"socket_port": {"host": "127.0.0.1", "port": port, **settings}}
    content = {"version": 1, "name": "f", "robots": {"arm": {"plugins": plugins, "timeout_s": WAIT_S}}}
    with Fleet(EALConfigManager.of(content, name="test").fleet) as fleet:
        yield fleet["arm"]["SocketPort"]


@pytest.fixture
def peer() -> Iterator[socket.socket]:
    """The other end of datagrams."""
    with socket.socket(type=socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        peer.settimeout(WAIT_S)
        yield peer


class TestTcp:
    def test_bytes_go_there_and_back_in_exact_counts(self, server: Server) -> None:
        with connected(server.port, timeout_s=WAIT_S) as port:
            peer = server.accept()
            assert port.write_comm("hello").get() == 5
            assert peer.recv(100) == b"hello"
            reading = port.read_comm(6)
            peer.sendall(b"wor")
            peer.sendall(b"ld, and more")
            assert reading.get().value == b"world,"

    def test_a_slow_peer_gets_everything_and_holds_nobody_up(self, server: Server) -> None:
        much = bytes(range(256)) * 100_000
        with connected(server.port, timeout_s=WAIT_S) as port:
            peer = server.accept()
            writing = port.write_comm(much)
            assert port.get_config("timeout_s").get().value == WAIT_S
            assert not writing.done()  # it is more than the buffers hold
            heard = bytearray()
            while len(heard) < len(much):
                heard += peer.recv(1 << 20)
            assert writing.get() == len(much)
            assert heard == much

    def test_a_peer_that_takes_nothing_is_told_after_the_timeout(self, server: Server) -> None:
        with connected(server.port, timeout_s=0.2) as port:
            server.accept()
            with pytest.raises(UnavailableError, match=r"took only \d+ of 50000000 bytes, and then none for 0\.2 s"):
                port.write_comm(bytes(50_000_000)).get()

    def test_a_server_that_hangs_up_and_comes_back(self, server: Server) -> None:
        with connected(server.port, timeout_s=WAIT_S) as port:
            server.accept()
            reading = port.read_comm(1)
            port.get_config("timeout_s").get()  # it has begun
            server.go_away()
            with pytest.raises(NotReadyError, match="the other end has closed the connection; next try in"):
                reading.get()
            server.come_back()
            peer = server.accept()  # it has come back by itself
            peer.sendall(b"again")
            resource: Any = port.resource()
            assert resource.port.wait_until_open(WAIT_S)
            assert port.read_comm(5).get().value == b"again"

    def test_an_absent_server_is_not_ready(self, server: Server) -> None:
        server.go_away()
        with (
            connected(server.port) as port,
            pytest.raises(NotReadyError, match=f"cannot open tcp://127.0.0.1:{server.port}: connection refused"),
        ):
            port.read_comm(1).get()

    def test_a_local_port_is_for_udp(self, server: Server) -> None:
        with (
            pytest.raises((PluginError, RobotFailedError), match="local_port needs protocol: udp"),
            connected(server.port, local_port=4000) as port,
        ):
            port.read_comm(1).get()


class TestUdp:
    def test_datagrams_stay_whole_whatever_the_length_asked_for(self, peer: socket.socket) -> None:
        with connected(peer.getsockname()[1], protocol="udp", timeout_s=WAIT_S) as port:
            assert port.write_comm("one").get() == 3
            datagram, address = peer.recvfrom(100)
            assert datagram == b"one"
            for text in (b"first", b"second", b"3"):
                peer.sendto(text, address)
            assert port.read_comm(100).get().value == b"first"
            with pytest.raises(ArgumentError, match="next datagram has 6 bytes, more than the 5 requested; it stays"):
                port.read_comm(5).get()
            assert port.read_comm(6).get().value == b"second"
            assert port.read_comm(6).get().value == b"3"

    def test_strangers_are_not_heard(self, peer: socket.socket) -> None:
        with (
            connected(peer.getsockname()[1], protocol="udp", timeout_s=WAIT_S) as port,
            socket.socket(type=socket.SOCK_DGRAM) as stranger,
        ):
            port.write_comm("x").get()
            _, address = peer.recvfrom(100)
            stranger.sendto(b"obey me", address)
            peer.sendto(b"friend", address)
            assert port.read_comm(100).get().value == b"friend"

    def test_silence_is_told_after_the_timeout(self, peer: socket.socket) -> None:
        with (
            connected(peer.getsockname()[1], protocol="udp", timeout_s=0.1) as port,
            pytest.raises(UnavailableError, match=r"no datagram came from udp://127\.0\.0\.1:\d+ within 0\.1 s"),
        ):
            port.read_comm(10).get()

    def test_nobody_at_the_other_end_is_no_failure(self, peer: socket.socket) -> None:
        number = peer.getsockname()[1]
        peer.close()
        with connected(number, protocol="udp", timeout_s=WAIT_S) as port:
            assert [port.write_comm("anybody?").get() for _ in range(5)] == [8] * 5
            with socket.socket(type=socket.SOCK_DGRAM) as late:
                late.bind(("127.0.0.1", number))
                late.settimeout(WAIT_S)
                port.write_comm("now?").get()
                assert late.recv(100) == b"now?"

    def test_no_datagram_is_too_long_unnoticed(self, peer: socket.socket) -> None:
        with connected(peer.getsockname()[1], protocol="udp") as port:
            with pytest.raises(ArgumentError, match="a datagram holds at most 65507 bytes, not 65508"):
                port.write_comm(bytes(65508)).get()
            assert port.write_comm(bytes(65507)).get() == 65507
            assert len(peer.recv(70000)) == 65507

    def test_the_local_port_is_the_one_that_was_asked_for(self, peer: socket.socket) -> None:
        with socket.socket(type=socket.SOCK_DGRAM) as probe:
            probe.bind(("", 0))
            local = int(probe.getsockname()[1])
        with connected(peer.getsockname()[1], protocol="udp", local_port=local) as port:
            port.write_comm("x").get()
            assert peer.recvfrom(10)[1] == ("127.0.0.1", local)
