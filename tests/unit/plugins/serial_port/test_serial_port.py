"""The serial_port plugin on real pseudo-terminals: exact counts, order, framing, and a cable that is pulled out."""

from __future__ import annotations

import itertools
import os
import termios
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from eal_actors import Fleet
from eal_actors.actors.handles import ResourceHandle
from eal_actors.kernel.errors import ArgumentError, NotReadyError, PreemptedError
from eal_actors.managers.config import EALConfigManager
from tests.unit.device.port_rig import WAIT_S, Cable
from tests.unit.device.test_serial_ports import serial_server

FAST = 4_000_000


@pytest.fixture
def cable(tmp_path: Path) -> Iterator[Cable]:
    cable = Cable(tmp_path / "ttyUSB0")
    cable.plug_in()
    yield cable
    cable.unplug()


@contextmanager
def line(cable: Cable, **settings: Any) -> Iterator[ResourceHandle]:
    plugins = {"serial_port": {"port": str(cable.path), **settings}}
    content = {"version": 1, "name": "f", "robots": {"buoy": {"plugins": plugins, "timeout_s": WAIT_S}}}
    with Fleet(EALConfigManager.of(content, name="test").fleet) as fleet:
        yield fleet["buoy"]["SerialPort"]


def test_what_is_written_comes_out_at_the_other_end_and_back(cable: Cable) -> None:
    with line(cable) as port:
        assert port.write_comm("hello").get() == 5
        assert cable.hear(5) == b"hello"
        assert port.write_comm(b"\x00\xff\x11\x13\r\n", 5).get() == 5
        assert cable.hear(5) == b"\x00\xff\x11\x13\r"  # nothing is translated
        cable.say(b"world!")
        assert port.read_comm(5, timeout_s=WAIT_S).get().value == b"world"
        assert port.get_status().get() == 1


def test_a_read_waits_until_all_is_there_while_others_are_answered(cable: Cable) -> None:
    with line(cable, timeout_s=WAIT_S) as port:
        reading = port.read_comm(6)
        cable.say(b"abc")
        assert port.get_config("baudrate").get().value == 9600
        assert not reading.done()
        cable.say(b"def")
        assert reading.get().value == b"abcdef"


def test_a_read_that_comes_too_early_returns_what_has_come(cable: Cable) -> None:
    with line(cable, timeout_s=0.2) as port:
        assert port.read_comm(10, timeout_s=WAIT_S).get().value == b""
        cable.say(b"abc")
        assert port.read_comm(10, timeout_s=WAIT_S).get().value == b"abc"
        assert port.get_status().get() == 0


def test_a_read_that_ends_behind_another_leaves_the_bytes_to_it(cable: Cable) -> None:
    with line(cable, timeout_s=WAIT_S) as port:
        first = port.read_comm(4)
        port.set_config("timeout_s", 0.1).get()
        second = port.read_comm(2, timeout_s=WAIT_S)
        cable.say(b"123")
        assert second.get().value == b""
        cable.say(b"4")
        assert first.get().value == b"1234"


def test_reads_are_served_in_their_order(cable: Cable) -> None:
    with line(cable, timeout_s=WAIT_S) as port:
        first, second = port.read_comm(4), port.read_comm(2)
        port.get_config("timeout_s").get()  # both have begun
        cable.say(b"12")  # enough for the second alone
        cable.say(b"3456")
        assert (first.get().value, second.get().value) == (b"1234", b"56")


def test_writers_never_interleave_and_a_long_text_goes_out_whole(cable: Cable) -> None:
    with line(cable, baudrate=FAST) as port:
        texts = [letter * 5000 for letter in "abcd"]
        writing = [port.write_comm(text) for text in texts]
        heard = cable.hear(20_000).decode()
        assert [call.get() for call in writing] == [5000] * 4
    assert [(letter, len(list(run))) for letter, run in itertools.groupby(heard)] == [
        (letter, 5000) for letter in "abcd"
    ]


def test_a_halt_ends_a_write_under_way(cable: Cable) -> None:
    with line(cable, baudrate=50) as port:  # ten bytes take two seconds
        writing = port.write_comm("x" * 100)
        assert cable.hear(2) == b"xx"
        port.halt().get()
        with pytest.raises(PreemptedError):
            writing.get()
        assert port.write_comm("y").get() == 1


def test_lengths_that_make_no_sense_are_refused(cable: Cable) -> None:
    with line(cable) as port:
        for call in (port.read_comm(-1), port.read_comm(1 << 21), port.write_comm("abc", 4), port.write_comm("a", -1)):
            assert isinstance(call.exception(), ArgumentError)
        assert port.read_comm(0).get().value == b""
        assert port.write_comm("").get() == 0


def test_what_was_not_read_can_be_discarded(cable: Cable) -> None:
    with line(cable, timeout_s=WAIT_S) as port:
        cable.say(b"old news")
        assert port.read_comm(4).get().value == b"old "
        port.send_cmd("discard").get()
        assert port.get_status().get() == 0
        cable.say(b"new")
        assert port.read_comm(3).get().value == b"new"


def speed_of(cable: Cable) -> int:
    return int(termios.tcgetattr(cable.device)[5])


def test_framing_changes_the_open_port_and_holds_when_it_comes_back(cable: Cable) -> None:
    with line(cable) as port:
        assert speed_of(cable) == termios.B9600
        port.set_config("baudrate", 57600).get()
        port.set_config("stopbits", 2).get()
        assert speed_of(cable) == termios.B57600
        cable.unplug()
        assert isinstance(port.write_comm("x").exception(), NotReadyError)
        cable.plug_in()
        wait_until_ready(port)
        assert speed_of(cable) == termios.B57600
        assert port.get_config("stopbits").get().value == 2
        port.write_comm("back").get()
        assert cable.hear(4) == b"back"


def wait_until_ready(port: ResourceHandle) -> None:
    resource: Any = port.resource()
    assert resource.port.wait_until_open(WAIT_S)


def test_a_framing_that_the_port_cannot_do_is_refused_and_changes_nothing(cable: Cable) -> None:
    with line(cable) as port:
        with pytest.raises(ArgumentError, match="cannot do SerialFraming"):
            port.set_config("parity", "E").get()  # a pseudo-terminal has no parity bit
        assert port.get_config("parity").get().value == "N"
        port.write_comm("x").get()
        assert cable.hear(1) == b"x"


def test_a_cable_that_is_pulled_out_during_a_read_ends_it(cable: Cable) -> None:
    with line(cable, timeout_s=WAIT_S) as port:
        reading = port.read_comm(5)
        port.get_config("timeout_s").get()  # it has begun
        cable.unplug()
        with pytest.raises(NotReadyError, match="was lost"):
            reading.get()


def test_closing_frees_the_port_for_others(cable: Cable) -> None:
    with line(cable) as port:
        port.write_comm("x").get()
        busy = os.open(cable.path, os.O_RDWR | os.O_NOCTTY)
        os.close(busy)
    with line(cable) as port:  # exclusive, so it would not be ready
        assert port.write_comm("y").get() == 1


def test_the_settings_name_the_resource(cable: Cable) -> None:
    plugins = {"gps": {"plugin": "serial_port", "port": str(cable.path), "name": "Gps"}}
    content = {"version": 1, "name": "f", "robots": {"buoy": {"plugins": plugins, "timeout_s": WAIT_S}}}
    with Fleet(EALConfigManager.of(content, name="test").fleet) as fleet:
        assert list(fleet["buoy"]) == ["Gps"]
        assert fleet["buoy"]["Gps"].write_comm("x").get() == 1


@pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning")  # of pyserial
def test_the_control_lines_are_set_at_the_far_end() -> None:
    with serial_server() as (url, far):
        plugins = {"serial_port": {"port": url, "dtr": False}}
        content = {"version": 1, "name": "f", "robots": {"buoy": {"plugins": plugins, "timeout_s": WAIT_S}}}
        with Fleet(EALConfigManager.of(content, name="test").fleet) as fleet:
            port = fleet["buoy"]["SerialPort"]
            assert (port.get_config("dtr").get().value, port.get_config("rts").get().value) == (False, True)
            assert (far.dtr, far.rts) == (False, True)
            port.set_config("dtr", True).get()
            port.set_config("rts", False).get()
            assert (far.dtr, far.rts) == (True, False)
