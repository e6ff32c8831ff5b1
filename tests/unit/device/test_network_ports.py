"""Ports behind a network that vanish and come back: real TCP listeners."""

from __future__ import annotations

import os
import resource
import select
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

import pytest

from eal_actors.device.ports import BytePort, ReopeningPort
from eal_actors.device.serial_ports import open_serial
from eal_actors.device.sockets import TcpPort, UdpPort, open_tcp
from eal_actors.kernel.errors import NotReadyError
from tests.manual_clock import ManualClock
from tests.unit.device.port_rig import WAIT_S, Server, drain, server

__all__ = ["server"]


def receive_all(connection: socket.socket) -> None:
    while connection.recv(1 << 20):
        pass


@contextmanager
def reopening_serial(server: Server) -> Iterator[tuple[ReopeningPort, list[Any]]]:
    """Open a serial port at a server; yield it and the ports that it has opened so far."""
    opened: list[Any] = []

    def open_it() -> BytePort:
        opened.append(port := open_serial(server.url, baudrate=9600))
        return port

    with closing(ReopeningPort(open_it, ManualClock(), server.url)) as port:
        port.open()
        yield port, opened


def test_a_server_that_goes_away_and_comes_back_is_found_again(server: Server) -> None:
    with reopening_serial(server) as (port, opened):
        peer = server.accept()
        peer.sendall(b"last words")
        server.go_away()
        assert drain(port, 10, opened[0].fileno()) == b"last words"
        assert select.select([opened[0].fileno()], [], [], WAIT_S)[0]
        with pytest.raises(NotReadyError, match="was lost: the other end has closed the connection"):
            port.read()
        server.come_back()
        assert port.wait_until_open(WAIT_S)
        assert port.openings == 2
        port.write(b"hello")
        assert server.accept().recv(5) == b"hello"


def test_an_idle_port_notices_that_its_server_is_gone_after_the_last_bytes(server: Server) -> None:
    with reopening_serial(server) as (port, opened):
        server.accept().sendall(b"last words")
        assert select.select([opened[0].fileno()], [], [], WAIT_S)[0]
        server.go_away()
        gone = select.poll()
        gone.register(opened[0].fileno(), select.POLLRDHUP)
        assert gone.poll(WAIT_S * 1000)
        assert port.why_not_ready() is None
        assert port.read() == b"last words"
        assert "was lost: unplugged, or closed at the other end" in str(port.why_not_ready())


def test_a_refused_connection_is_an_absent_device(server: Server) -> None:
    server.go_away()
    with closing(ReopeningPort(lambda: open_serial(server.url, baudrate=9600), ManualClock(), server.url)) as port:
        port.open()
        assert str(port.why_not_ready()).startswith(f"cannot open {server.url}: connection refused; next try in 0.")


def test_a_tcp_port_hands_over_every_byte_before_the_end(server: Server) -> None:
    with closing(open_tcp("127.0.0.1", server.port)) as port:
        server.accept().sendall(b"last words")
        server.go_away()
        assert select.select([port.fileno()], [], [], WAIT_S)[0]
        assert port.in_waiting == 10
        assert (port.read(4), port.read(100)) == (b"last", b" words")
        with pytest.raises(ConnectionError, match="closed the connection"):
            port.read(1)


def test_a_peer_that_takes_nothing_breaks_the_port_and_never_hears_of_it(server: Server) -> None:
    opened: list[TcpPort] = []

    def open_it() -> TcpPort:
        opened.append(open_tcp("127.0.0.1", server.port))
        return opened[-1]

    with closing(ReopeningPort(open_it, ManualClock(), server.url)) as port:
        port.open()
        peer = server.accept()
        much = bytes(64 * 1024 * 1024)  # more than the buffers of both ends
        with pytest.raises(NotReadyError, match=r"took only \d+ of 67108864 bytes in 0\.2 s"):
            port.write(much)
        assert port.wait_until_open(WAIT_S)
        with pytest.raises(ConnectionResetError):  # what was not sent is dropped, instead of carried out late
            receive_all(peer)


@contextmanager
def many_descriptors() -> Iterator[None]:
    """Take the descriptors below 1024, which is as many as `select` knows."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(2048, hard), hard))
    taken = [os.open(os.devnull, os.O_RDONLY)]
    try:
        while taken[-1] < 1024:
            taken.append(os.dup(taken[0]))
        yield
    finally:
        for descriptor in taken:
            os.close(descriptor)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_ports_work_in_a_program_with_more_than_a_thousand_descriptors(server: Server) -> None:
    with many_descriptors(), closing(open_tcp("127.0.0.1", server.port)) as tcp:
        assert tcp.fileno() > 1024
        with pytest.raises(TimeoutError, match="took only"):  # nobody reads
            tcp.write(bytes(1 << 24))
        with closing(UdpPort("127.0.0.1", 9)) as udp:
            assert udp.in_waiting == 0
            udp.reset_input_buffer()


def test_a_datagram_behind_a_refusal_is_seen() -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as peer, socket.socket(type=socket.SOCK_DGRAM) as probe:
        for end in (peer, probe):
            end.bind(("127.0.0.1", 0))
        (_, far), (_, near) = peer.getsockname(), probe.getsockname()
        probe.close()
        with closing(UdpPort("127.0.0.1", far, near)) as port:
            peer.close()
            port.write(b"is anybody there?")
            with socket.socket(type=socket.SOCK_DGRAM) as later:
                later.bind(("127.0.0.1", far))
                later.sendto(b"now", ("127.0.0.1", near))
                assert port.in_waiting == 1
                assert port.read() == b"now"
