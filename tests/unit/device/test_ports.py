"""Serial ports that vanish and come back: real pseudo-terminals behind a link's name."""

from __future__ import annotations

import os
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from typing import Any

import pytest

from eal_actors.device.ports import BytePort, ReopeningDevice, ReopeningPort
from eal_actors.device.serial_ports import open_serial
from eal_actors.kernel.errors import NotReadyError, PluginError, UnavailableError
from tests.manual_clock import ManualClock
from tests.unit.device.port_rig import WAIT_S, Cable, cable, drain

__all__ = ["cable"]


def serial_port(cable: Cable) -> ReopeningPort:
    path = str(cable.path)
    return ReopeningPort(lambda: open_serial(path, baudrate=57600), ManualClock(), path)


def test_an_absent_device_is_no_error_and_is_opened_when_it_comes(cable: Cable) -> None:
    with closing(serial_port(cable)) as port:
        port.open()
        reason = port.why_not_ready()
        assert reason is not None
        assert reason.startswith(f"cannot open {cable.path}: no such file or directory; next try in 0.")
        with pytest.raises(NotReadyError, match="no such file or directory"):
            port.write(b"x")
        assert port.openings == 0
        cable.plug_in()
        assert port.wait_until_open(WAIT_S)
        assert (port.why_not_ready(), port.openings) == (None, 1)
        assert port.write(b"hello") == 5
        assert cable.hear(5) == b"hello"


def test_a_device_that_is_unplugged_comes_back_under_the_same_name(cable: Cable) -> None:
    cable.plug_in()
    with closing(serial_port(cable)) as port:
        port.open()
        assert port.openings == 1
        for openings in (2, 3):
            cable.unplug()
            with pytest.raises(NotReadyError, match=rf"{cable.path} was lost: .*; next try in 0\.[0-2] s"):
                port.read()
            assert port.why_not_ready() is not None
            cable.plug_in()
            assert port.wait_until_open(WAIT_S)
            assert port.openings == openings
            port.write(b"again")
            assert cable.hear(5) == b"again"


@pytest.mark.parametrize("use", ["write", "in_waiting", "reset"])
def test_every_use_of_a_broken_port_notices_it(cable: Cable, use: str) -> None:
    uses: dict[str, Any] = {
        "write": lambda port: port.write(b"x"),
        "in_waiting": lambda port: port.in_waiting,
        "reset": lambda port: port.reset_input_buffer(),  # pyserial lets termios.error through, which is no OSError
    }
    cable.plug_in()
    with closing(serial_port(cable)) as port:
        port.open()
        cable.unplug()
        with pytest.raises(NotReadyError, match="was lost: "):
            uses[use](port)


def test_a_port_that_somebody_else_has_is_not_ready_until_it_is_free(cable: Cable) -> None:
    cable.plug_in()
    other = open_serial(str(cable.path), baudrate=9600)
    with closing(serial_port(cable)) as port:
        port.open()
        assert f"this program (pid {os.getpid()}) has it open; next try" in str(port.why_not_ready())
        other.close()
        assert port.wait_until_open(WAIT_S)


def test_reading_never_waits_and_returns_what_is_there(cable: Cable) -> None:
    cable.plug_in()
    opened: list[Any] = []

    def open_it() -> BytePort:
        opened.append(port := open_serial(str(cable.path), baudrate=57600))
        return port

    with closing(ReopeningPort(open_it, ManualClock(), "pty")) as port:
        port.open()
        assert port.read() == b""
        cable.say(b"abcdef")
        assert drain(port, 4, opened[0].fileno()) == b"abcd"
        assert port.in_waiting == 2
        port.reset_input_buffer()
        assert port.read() == b""


def test_writers_in_many_threads_never_interleave(cable: Cable) -> None:
    cable.plug_in()
    frames = [bytes([letter]) * 40 for letter in range(16)]
    with closing(serial_port(cable)) as port, ThreadPoolExecutor(len(frames)) as pool:
        port.open()
        start = threading.Barrier(len(frames))

        def write(frame: bytes) -> None:
            start.wait(WAIT_S)
            for _ in range(3):
                port.write(frame)

        written = [pool.submit(write, frame) for frame in frames]
        heard = cable.hear(40 * 3 * len(frames))
        for future in written:
            future.result(WAIT_S)
    pieces = [heard[start : start + 40] for start in range(0, len(heard), 40)]
    assert sorted(pieces) == sorted(frames * 3)


def test_a_use_may_use_the_port_by_its_methods(cable: Cable) -> None:
    cable.plug_in()
    with closing(serial_port(cable)) as port, ThreadPoolExecutor(1) as pool:
        port.open()

        def ask(_: BytePort) -> bytes:
            port.reset_input_buffer()
            port.write(b"?")
            assert port.why_not_ready() is None
            return port.read()

        assert pool.submit(port.use, ask).result(WAIT_S) == b""
        assert cable.hear(1) == b"?"
        cable.unplug()
        with pytest.raises(NotReadyError, match="was lost"):
            pool.submit(port.use, ask).result(WAIT_S)
        cable.plug_in()
        assert port.wait_until_open(WAIT_S)
        assert pool.submit(port.use, ask).result(WAIT_S) == b""


def test_closing_frees_the_port_and_ends_the_tries(cable: Cable) -> None:
    cable.plug_in()
    port = serial_port(cable)
    port.open()
    port.close()
    with closing(open_serial(str(cable.path), baudrate=9600)):  # exclusive: nobody else has it
        pass
    with pytest.raises(NotReadyError, match=f"{cable.path} is closed"):
        port.write(b"x")
    with pytest.raises(NotReadyError, match=f"{cable.path} is closed"):
        port.open()
    port.close()
    waiting = ReopeningPort(lambda: open_serial("/nowhere/tty", baudrate=9600), ManualClock(), "/nowhere/tty")
    waiting.open()
    waiting.close()
    assert "reopening /nowhere/tty" not in [thread.name for thread in threading.enumerate()]


@pytest.mark.parametrize(
    ("url", "says"),
    [
        ("foo://x", "foo://x: invalid URL, protocol 'foo' not known"),
        ("socket://localhost", "wanted is socket://host:port"),
        ("socket://localhost:http", "Port could not be cast to integer"),
        ("socket://:80", "wanted is socket://host:port"),
        ("/", "/ is no serial port, but a folder"),
        (__file__, f"{__file__} is no serial port, but a file"),
        ("/dev/null", "/dev/null is no serial port, but another device"),
    ],
)
def test_a_wrong_configuration_is_no_absent_device(url: str, says: str) -> None:
    port = ReopeningPort(lambda: open_serial(url, baudrate=9600), ManualClock(), url)
    with pytest.raises(PluginError) as caught:
        port.open()
    assert says in caught.value.message


def test_the_framing_is_checked(cable: Cable) -> None:
    cable.plug_in()
    with pytest.raises(PluginError, match="Not a valid parity: 'X'"):
        open_serial(str(cable.path), baudrate=9600, parity="X")


class Simulated:
    """A port whose robot can be dead, which is no broken wire."""

    in_waiting = 0

    def __init__(self) -> None:
        self.is_dead = True

    def read(self, size: int = 1) -> bytes:
        if self.is_dead:
            raise UnavailableError("the robot is dead")
        return b"alive"[:size]

    def write(self, data: bytes) -> None:
        self.read()

    def reset_input_buffer(self) -> None:
        self.read()

    def close(self) -> None:
        self.is_dead = True


def test_errors_of_the_framework_pass_and_break_nothing() -> None:
    simulated = Simulated()
    with closing(ReopeningPort(lambda: simulated, ManualClock(), "sim://world")) as port:
        port.open()
        with pytest.raises(UnavailableError, match="the robot is dead"):
            port.write(b"x")
        simulated.is_dead = False
        assert (port.read(), port.write(b"xy"), port.openings) == (b"alive", 2, 1)


def test_the_tries_become_less_frequent_and_go_on_whatever_the_opener_raises() -> None:
    tries: list[str | None] = []
    enough = threading.Event()

    def open_it() -> BytePort:
        tries.append(port.why_not_ready())
        if len(tries) == 4:
            enough.set()
        raise RuntimeError("no idea")

    port = ReopeningPort(open_it, ManualClock(), "odd")
    with closing(port), pytest.raises(RuntimeError):
        port.open()  # only the first opening tells of an error in the opener

    def absent_first() -> BytePort:
        if tries:
            return open_it()
        tries.append(None)
        raise OSError("absent")

    tries.clear()
    port = ReopeningPort(absent_first, ManualClock(), "odd")
    with closing(port):
        port.open()
        assert str(port.why_not_ready()).startswith("cannot open odd: absent; next try in 0.")
        assert enough.wait(WAIT_S)  # after 0.2 s, 0.4 s and 0.8 s
    assert [str(reason).partition(";")[0] for reason in tries[2:]] == ["cannot open odd: no idea"] * 2


def test_an_idle_port_notices_that_its_cable_was_unplugged(cable: Cable) -> None:
    cable.plug_in()
    with closing(serial_port(cable)) as port:
        port.open()
        assert port.why_not_ready() is None
        cable.unplug()
        assert "was lost: unplugged" in str(port.why_not_ready())
        cable.plug_in()
        assert port.wait_until_open(WAIT_S)
        assert (port.why_not_ready(), port.openings) == (None, 2)


def test_a_device_of_a_library_reopens_too() -> None:
    """The object of a vendor's library owns its port; it needs nothing but `close`."""

    class Library:
        is_broken = False

        def ask(self) -> int:
            if self.is_broken:
                raise OSError(5, "Input/output error")
            return 42

        def close(self) -> None:
            closed.append(self)

    closed: list[Library] = []
    device = ReopeningDevice(Library, ManualClock(), "arm")
    with closing(device):
        device.open()
        assert device.use(Library.ask) == 42
        broken = device.use(lambda library: library)
        broken.is_broken = True
        with pytest.raises(NotReadyError, match="arm was lost: input/output error"):
            device.use(Library.ask)
        assert device.wait_until_open(WAIT_S)
        assert (device.use(Library.ask), device.openings, closed) == (42, 2, [broken])
