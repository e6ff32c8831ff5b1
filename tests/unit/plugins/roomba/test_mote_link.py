"""plugins/roomba: stop-and-wait to the base mote, and the motes at the other end."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eal_actors.kernel.errors import UnavailableError
from plugins.roomba.mote_link import MOST_WAITING, MoteLink
from plugins.roomba.motes import MotePair
from plugins.roomba.sci import drive
from plugins.roomba.tinyos import Ack, Packet, TinyosFraming
from tests.manual_clock import ManualClock

FRAMING = TinyosFraming()
T = TypeVar("T")


@dataclass
class Line:
    """A port whose other end is the test: it reads packets, and acknowledges them or not."""

    name: str = "line"
    openings: int = 1
    in_waiting: int = 0
    packets: list[Packet] = field(default_factory=list)
    acknowledges: bool = True
    _incoming: bytearray = field(default_factory=bytearray)
    _deframer: Any = field(default_factory=FRAMING.deframer)

    def why_not_ready(self) -> str | None:
        return None

    def write(self, data: bytes) -> int:
        for body in self._deframer.feed(data):
            packet = FRAMING.read(body)
            assert isinstance(packet, Packet)
            self.packets.append(packet)
            if self.acknowledges and packet.sequence is not None:
                self.say(FRAMING.ack(packet.sequence))
        return len(data)

    def say(self, data: bytes) -> None:
        self._incoming += data

    def read(self, size: int = 1) -> bytes:
        data = bytes(self._incoming[:size])
        del self._incoming[:size]
        return data

    def reset_input_buffer(self) -> None:
        self._incoming.clear()

    def close(self) -> None:
        pass

    def use(self, action: Callable[[Any], T]) -> T:
        return action(self)

    def take_sent(self) -> list[tuple[int | None, bytes]]:
        sent = [(packet.sequence, packet.payload) for packet in self.packets]
        self.packets.clear()
        return sent


class Bench:
    def __init__(self, tries: int = 3) -> None:
        self.clock = ManualClock()
        self.line = Line()
        self.link = MoteLink(self.line, self.clock, FRAMING, tries)

    def wait(self, duration_s: float) -> bytes:
        self.clock.advance(duration_s)
        return self.link.receive()


def test_after_the_port_was_opened_again_nothing_old_is_sent() -> None:
    line = Line()
    line.acknowledges = False
    link = MoteLink(line, ManualClock(), FRAMING, 3)
    link.send(b"\x80")
    link.send(b"\x81")
    assert line.take_sent() == [(1, b"\x80")]
    line.openings += 1
    line.acknowledges = True
    link.send(b"\x82")
    link.receive()
    assert line.take_sent() == [(2, b"\x82")]


def test_a_question_goes_at_once_and_is_not_repeated() -> None:
    bench = Bench()
    bench.line.acknowledges = False
    bench.link.send(b"a")
    bench.line.take_sent()
    bench.link.ask(b"\x8e\x00")
    assert bench.line.take_sent() == [(None, b"\x8e\x00")]
    bench.line.acknowledges = True
    bench.wait(0.2)
    assert bench.line.take_sent() == [(1, b"a")]


def test_a_question_whose_closing_flag_is_lost_arrives_before_the_next_packet() -> None:
    bench = Bench()
    say = bench.line.write
    bench.line.write = lambda data: say(data[: data.index(0x7E, 1)] + data[data.index(0x7E, 1) + 1 :])  # type: ignore[method-assign]
    bench.link.ask(b"\x8e\x02")
    assert bench.line.take_sent() == [(None, b"\x8e\x02")]


def test_it_tells_when_the_latest_commands_came() -> None:
    bench = Bench()
    bench.line.acknowledges = False
    bench.link.send(b"a1")
    bench.wait(0.2)
    bench.link.send(b"a2", supersedes=True)
    assert bench.link.unsure_s == (0.0, math.inf)
    bench.line.acknowledges = True
    bench.wait(0.2)
    bench.wait(0.0)
    assert bench.link.unsure_s == pytest.approx((0.0, 0.4))
    bench.link.send(b"b")
    bench.wait(0.0)
    assert bench.link.unsure_s == pytest.approx((0.4, 0.4))


def test_one_packet_at_a_time_is_under_way() -> None:
    bench = Bench()
    bench.line.acknowledges = False
    for byte in (b"a", b"b", b"c"):
        bench.link.send(byte)
    assert bench.line.take_sent() == [(1, b"a")]
    assert bench.link.is_busy
    bench.line.say(FRAMING.ack(9))  # of no packet that is under way
    bench.wait(0.0)
    assert bench.line.take_sent() == []
    bench.line.say(FRAMING.ack(1))
    bench.wait(0.0)
    assert bench.line.take_sent() == [(2, b"b")]
    bench.line.acknowledges = True
    bench.line.say(FRAMING.ack(2))
    for _ in range(3):
        bench.wait(0.0)
    assert bench.line.take_sent() == [(3, b"c")]
    assert not bench.link.is_busy


def test_what_is_not_acknowledged_is_sent_again_with_its_number_and_then_given_up_loudly() -> None:
    bench = Bench(tries=3)
    bench.line.acknowledges = False
    bench.link.send(b"a")
    bench.link.send(b"b")
    bench.wait(0.099)
    assert bench.line.take_sent() == [(1, b"a")]
    bench.wait(0.002)
    bench.wait(0.1)
    assert bench.line.take_sent() == [(1, b"a"), (1, b"a")]
    with pytest.raises(UnavailableError, match="mote on line does not acknowledge: packet 1 was sent 3 times"):
        bench.wait(0.1)
    assert not bench.link.is_busy  # what waited is dropped: it must not be carried out when the mote is back
    bench.line.acknowledges = True
    bench.link.send(b"c")
    assert bench.line.take_sent() == [(2, b"c")]


def test_a_queue_that_is_full_is_said_and_dropped() -> None:
    bench = Bench()
    bench.line.acknowledges = False
    for _ in range(MOST_WAITING + 1):
        bench.link.send(b"a")
    with pytest.raises(UnavailableError, match=f"mote on line is too slow: {MOST_WAITING} packets wait; all are"):
        bench.link.send(b"a")


def test_a_stop_overtakes_what_waits_and_what_is_under_way() -> None:
    bench = Bench()
    bench.line.acknowledges = False
    bench.link.send(b"a")
    bench.link.send(b"b")
    bench.line.take_sent()
    bench.link.urge(b"stop")
    assert bench.line.take_sent() == [(2, b"stop")]
    bench.line.say(FRAMING.ack(1))  # of the one that it overtook
    bench.wait(0.1)
    assert bench.line.take_sent() == [(2, b"stop")]
    bench.line.say(FRAMING.ack(2))
    bench.wait(0.0)
    assert not bench.link.is_busy


def test_what_is_out_of_date_does_not_wait() -> None:
    bench = Bench()
    bench.line.acknowledges = False
    for data in (b"\x8e\x00", b"\x89old", b"\x82", b"\x89new", b"\x8e\x00"):
        bench.link.send(data, supersedes=data[0] != 0x82)
    bench.line.acknowledges = True
    bench.line.say(FRAMING.ack(1))
    for _ in range(5):
        bench.wait(0.1)
    sent = [payload for payload, _ in itertools.groupby(payload for _, payload in bench.line.take_sent())]
    assert sent == [b"\x8e\x00", b"\x82", b"\x89new", b"\x8e\x00"]


def test_a_newer_command_replaces_the_one_under_way() -> None:
    bench = Bench()
    bench.line.acknowledges = False
    bench.link.send(b"\x89old", supersedes=True)
    bench.link.send(b"\x89new", supersedes=True)
    assert bench.line.take_sent() == [(1, b"\x89old"), (2, b"\x89new")]
    bench.line.acknowledges = True
    bench.wait(0.1)
    assert bench.line.take_sent() == [(2, b"\x89new")]


def test_long_data_goes_in_several_packets_and_packets_in_are_put_together() -> None:
    bench = Bench()
    bench.link.send(bytes(range(60)))
    for _ in range(5):
        bench.wait(0.0)
    assert [payload for _, payload in bench.line.take_sent()] == [
        bytes(range(28)),
        bytes(range(28, 56)),
        bytes(range(56, 60)),
    ]
    bench.line.say(FRAMING.packet(b"one ", None) + b"noise" + FRAMING.packet(b"two", None))
    bench.line.say(TinyosFraming(group=7).packet(b"of others", None) + TinyosFraming(am_type=7).packet(b"too", None))
    assert bench.link.receive() == b"one two"


def test_sequence_numbers_begin_anew_after_255() -> None:
    bench = Bench()
    for _ in range(300):
        bench.link.send(b"x")
        bench.link.receive()
    numbers = [number for number, _ in bench.line.take_sent()]
    assert numbers == [(1 + count) % 256 for count in range(300)]


# The motes.


@dataclass
class Ear:
    """A robot that notes what it hears."""

    heard: list[bytes] = field(default_factory=list)
    says: bytes = b""

    def feed(self, data: bytes, now_s: float) -> bytes:
        if data:
            self.heard.append(data)
        said, self.says = self.says, b""
        return said


def test_the_base_mote_answers_the_packet_of_the_protocol_page() -> None:
    sent = bytes.fromhex("7e 44 26 00 ff ff 00 00 04 22 89 7d 5e 7d 5d 01 02 31 3c 7e")
    ear = Ear()
    motes = MotePair(ear, FRAMING)
    assert motes.feed(sent, 0.0) == bytes.fromhex("7e 43 26 3b 1c 7e")
    assert motes.feed(sent, 0.1) == bytes.fromhex("7e 43 26 3b 1c 7e")
    assert (ear.heard, motes.duplicates) == ([bytes.fromhex("7e 7d 01 02")] * 2, 1)  # stock motes filter nothing


def test_what_the_robot_says_comes_in_packets_that_want_no_acknowledgement() -> None:
    motes = MotePair(Ear(says=bytes(range(30))), FRAMING)
    assert motes.feed(b"", 0.0) == FRAMING.packet(bytes(range(28)), None) + FRAMING.packet(bytes([28, 29]), None)


def test_the_mote_on_the_robot_stops_it_when_it_hears_nothing() -> None:
    ear = Ear()
    motes = MotePair(ear, FRAMING, watchdog_s=1.0)
    motes.feed(FRAMING.packet(drive(200), 1), 0.0)
    motes.feed(b"", 0.9)
    assert ear.heard == [drive(200)]
    motes.feed(b"", 1.1)
    motes.feed(b"", 3.0)
    assert ear.heard == [drive(200), drive(0)]


def test_the_motes_take_no_notice_of_what_is_not_theirs() -> None:
    ear = Ear()
    motes = MotePair(ear, FRAMING)
    assert motes.feed(FRAMING.ack(1) + b"noise" + TinyosFraming(group=1).packet(b"x", None), 0.0) == b""
    assert ear.heard == []


@given(seed=st.integers(0, 2**32), count=st.integers(1, 40), ack_loss=st.floats(0, 0.8))
def test_lost_acknowledgements_are_made_up_for_in_order(seed: int, count: int, ack_loss: float) -> None:
    clock, ear = ManualClock(), Ear()
    motes = MotePair(ear, FRAMING, ack_loss=ack_loss, seed=seed, watchdog_s=1e9)

    class Wire(Line):
        def write(self, data: bytes) -> int:
            self.say(motes.feed(data, clock.now()))
            return len(data)

    link = MoteLink(Wire(), clock, FRAMING, tries=200)
    wanted = [bytes([128 + number % 16, number]) for number in range(count)]
    for data in wanted:
        link.send(data)
        while link.is_busy:
            clock.advance(0.1)
            link.receive()
    assert [data for data, _ in itertools.groupby(ear.heard)] == wanted  # some came twice


@given(data=st.binary(max_size=300), pieces=st.integers(1, 7))
def test_any_bytes_never_crash_the_motes_or_the_link(data: bytes, pieces: int) -> None:
    motes, line = MotePair(Ear(), FRAMING), Line()
    link = MoteLink(line, ManualClock(), FRAMING, 3)
    for start in range(0, len(data), pieces):
        motes.feed(data[start : start + pieces], 0.0)
        line.say(data[start : start + pieces])
        link.receive()
    motes.feed(b"\x7e" + FRAMING.packet(b"here", 200), 0.0)
    line.say(b"\x7e" + FRAMING.packet(b"there", None))
    assert link.receive().endswith(b"there")
    assert motes.forwarded[-1] == b"here"


def test_an_acknowledgement_is_read_as_such() -> None:
    assert FRAMING.read(bytes([0x43, 5])) == Ack(5)
