"""plugins/evbot2/firmware.py: each order once, nothing after a silence, moves by the encoders."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugins.evbot2.emulator import evbot2, free_vehicle
from plugins.evbot2.messages import BaseReply, BaseRequest, BaseWelcome, Code, State, Verb, WheelStatus
from plugins.evbot2.vehicle import FreeVehicle

TICK_S = 0.01
MOVE = (500_000, 500_000, 250_000)


class Bench:
    """A firmware, the body under it, and a time that goes on by ticks."""

    def __init__(self, *, greeted: bool = True) -> None:
        self.now_s = 0.0
        self.body: FreeVehicle = free_vehicle(lambda: self.now_s)
        self.device = evbot2(self.body, TICK_S, boot=41)
        self.firmware = self.device.firmware
        self.polls = 0
        self.lease = self.greet().lease if greeted else 0

    def say(self, verb: Verb, tag: int = 1, *numbers: int, lease: int | None = None) -> BaseReply:
        lease = lease if lease is not None else self.lease
        return self.firmware.handle(BaseRequest(verb, tag, lease, numbers), self.now_s)

    def greet(self, watchdog_ms: int = 500, host: int = 77) -> BaseWelcome:
        reply = self.say(Verb.HELLO, 1, 1, watchdog_ms, host, lease=0)
        assert reply.code is Code.OK
        return BaseWelcome(*reply.numbers[:6])

    def poll(self) -> WheelStatus:
        self.polls += 1
        reply = self.say(Verb.STAT, self.polls)
        assert reply.code is Code.OK
        return WheelStatus(*reply.numbers)

    def wait(self, duration_s: float, *, polled: bool = True) -> None:
        for tick in range(1, round(duration_s / TICK_S) + 1):
            self.now_s += TICK_S
            self.device.tick(self.now_s)
            if polled and tick % 10 == 0:
                self.poll()

    def until_done(self) -> WheelStatus:
        while (status := self.poll()).state == State.MOVING:
            self.wait(TICK_S, polled=False)
            assert self.now_s < 60
        return status


def test_it_says_what_it_is_and_gives_a_lease() -> None:
    bench = Bench(greeted=False)
    reply = bench.say(Verb.HELLO, 9, 1, 500, 77, lease=0)
    assert reply == BaseReply(Verb.HELLO, 9, Code.OK, (2, 1, 41, 42, 500, 400_000, 0, 0))
    assert bench.say(Verb.HELLO, 10, 1, 500, 77, lease=0).numbers[3] == 42  # the lease is not given out anew


@pytest.mark.parametrize(
    ("numbers", "code"), [((2, 500, 77), Code.VERSION), ((1, 99, 77), Code.RANGE), ((1, 5001, 77), Code.RANGE)]
)
def test_a_greeting_that_it_cannot_grant_is_refused(numbers: tuple[int, ...], code: Code) -> None:
    bench = Bench(greeted=False)
    assert bench.say(Verb.HELLO, 1, *numbers, lease=0) == BaseReply(Verb.HELLO, 1, code)
    assert bench.say(Verb.STAT, 1, lease=42).code is Code.LEASE


def test_another_host_is_kept_out_until_the_first_is_silent() -> None:
    bench = Bench()
    assert bench.say(Verb.HELLO, 1, 1, 500, 78, lease=0).code is Code.BUSY
    bench.wait(0.6, polled=False)
    assert bench.greet(host=78).lease == 43
    assert bench.say(Verb.MOVE, 1, *MOVE, lease=42).code is Code.LEASE


def test_an_order_is_carried_out_once_however_often_it_comes() -> None:
    bench = Bench()
    assert bench.say(Verb.MOVE, 1, *MOVE).code is Code.OK
    assert bench.until_done().state == State.DONE
    for _ in range(3):
        assert bench.say(Verb.MOVE, 1, *MOVE).code is Code.OK  # the same answer, and nothing else
    bench.wait(1.0)
    assert bench.body.pose[0] == pytest.approx(0.5, abs=0.0006)
    assert bench.firmware.executed == 1


def test_an_order_that_was_overtaken_is_not_carried_out() -> None:
    bench = Bench()
    assert bench.say(Verb.STOP, 2).code is Code.OK
    assert bench.say(Verb.MOVE, 1, *MOVE).code is Code.OLD
    bench.wait(1.0)
    assert bench.body.pose == (0.0, 0.0, 0.0)


def test_another_order_under_the_same_tag_is_refused() -> None:
    bench = Bench()
    assert bench.say(Verb.STOP, 1).code is Code.OK
    assert bench.say(Verb.MOVE, 1, *MOVE).code is Code.OLD


@pytest.mark.parametrize("watchdog_ms", [100, 500, 2000])
@pytest.mark.parametrize(
    ("verb", "numbers"), [(Verb.MOVE, (10_000_000, 10_000_000, 400_000)), (Verb.VEL, (200_000, 200_000, 60_000))]
)
def test_after_a_silence_it_stands_and_stays(verb: Verb, numbers: tuple[int, ...], watchdog_ms: int) -> None:
    bench = Bench(greeted=False)
    bench.lease = bench.greet(watchdog_ms).lease
    bench.say(verb, 1, *numbers)
    bench.wait(watchdog_ms / 1000, polled=False)
    assert bench.firmware.is_busy
    bench.wait(0.02, polled=False)
    assert not bench.firmware.is_busy
    bench.wait(0.5, polled=False)  # the wheels come to rest
    stood = bench.body.pose
    for tag in (1, 2):  # what comes late is not carried out
        assert bench.say(verb, tag, *numbers).code is Code.LEASE
    bench.wait(1.0, polled=False)
    assert bench.body.pose == stood
    bench.lease = bench.greet().lease
    assert State(bench.poll().state) is State.SILENT


def test_what_it_has_heard_before_does_not_keep_it_awake() -> None:
    bench = Bench()
    bench.say(Verb.MOVE, 1, 10_000_000, 10_000_000, 400_000)
    bench.poll()
    for _ in range(60):
        bench.wait(TICK_S, polled=False)
        bench.say(Verb.STAT, 1)  # an echo of the poll
        bench.say(Verb.MOVE, 1, 10_000_000, 10_000_000, 400_000)  # and one of the order
        bench.say(Verb.HELLO, 1, 1, 500, 77, lease=0)
    assert not bench.firmware.is_busy or bench.firmware.executed == 0
    assert bench.say(Verb.STAT, 2, lease=42).code is Code.LEASE


@pytest.mark.parametrize(
    ("verb", "numbers"),
    [
        (Verb.MOVE, (100_000_001, 0, 250_000)),
        (Verb.MOVE, (0, -100_000_001, 250_000)),
        (Verb.MOVE, (1000, 1000, 400_001)),
        (Verb.MOVE, (1000, 1000, 999)),
        (Verb.MOVE, (1000, 1000, -250_000)),
        (Verb.VEL, (400_001, 0, 500)),
        (Verb.VEL, (0, -400_001, 500)),
        (Verb.VEL, (0, 0, 19)),
        (Verb.VEL, (0, 0, 60_001)),
    ],
)
def test_what_is_out_of_range_moves_nothing(verb: Verb, numbers: tuple[int, ...]) -> None:
    bench = Bench()
    assert bench.say(verb, 1, *numbers).code is Code.RANGE
    assert not bench.firmware.is_busy


def test_it_has_no_turret() -> None:
    assert Bench().say(Verb.SWING, 1, 1000, 1000).code is Code.VERB


@pytest.mark.parametrize("left_um", [500_000, -500_000, 100_000, 3_000, 0])
@pytest.mark.parametrize("right_um", [500_000, -500_000, 2_000_000])
def test_both_wheels_travel_their_ways_in_the_same_time(left_um: int, right_um: int) -> None:
    bench = Bench()
    bench.say(Verb.MOVE, 1, left_um, right_um, 250_000)
    status = bench.until_done()
    assert (status.order, status.state) == (1, State.DONE)
    assert status.left * 0.0005 == pytest.approx(left_um / 1e6, abs=0.0011)
    assert status.right * 0.0005 == pytest.approx(right_um / 1e6, abs=0.0011)


def test_a_move_of_nothing_is_done() -> None:
    bench = Bench()
    bench.say(Verb.MOVE, 1, 0, 0, 250_000)
    assert bench.until_done().state == State.DONE
    assert bench.body.pose == (0.0, 0.0, 0.0)


def test_a_move_begins_from_rest() -> None:
    bench = Bench()
    bench.say(Verb.VEL, 1, 400_000, 400_000, 5000)
    bench.wait(1.5)
    bench.say(Verb.MOVE, 2, -30_000, 30_000, 100_000)
    bench.until_done()
    assert bench.body.pose[2] == pytest.approx(0.25, abs=0.009)


def test_held_speeds_end_by_themselves() -> None:
    bench = Bench()
    bench.say(Verb.VEL, 1, 200_000, 200_000, 700)
    bench.wait(2.0)
    assert bench.poll().state == State.DONE
    assert bench.body.pose[0] == pytest.approx(0.7 * 0.2 - 0.2**2 / (2 * 0.5), abs=0.02)


@pytest.mark.parametrize(("verb", "numbers"), [(Verb.MOVE, MOVE), (Verb.VEL, (200_000, 200_000, 9000))])
def test_wheels_that_count_nothing_are_stopped(verb: Verb, numbers: tuple[int, ...]) -> None:
    bench = Bench()
    bench.body.is_stuck = True
    bench.say(verb, 1, *numbers)
    bench.wait(1.0)
    assert (bench.poll().state, bench.poll().strain) == (State.MOVING, 1)
    bench.wait(1.0)
    assert (bench.poll().state, bench.poll().strain) == (State.STALLED, 0)


def test_a_stop_holds_at_once_and_is_told() -> None:
    bench = Bench()
    bench.say(Verb.MOVE, 1, *MOVE)
    bench.wait(1.0)
    assert bench.say(Verb.STOP, 2).code is Code.OK
    bench.wait(0.3)
    stood = bench.body.pose
    bench.wait(1.0)
    assert bench.body.pose == stood
    status = bench.poll()
    assert (status.order, status.state) == (1, State.STOPPED)


@pytest.mark.parametrize("late_s", [0.05, 0.1, 0.3])
def test_a_move_whose_ticks_come_late_ends_where_it_should(late_s: float) -> None:
    bench = Bench()
    bench.say(Verb.MOVE, 1, 300_000, 300_000, 400_000)
    while bench.poll().state == State.MOVING:
        bench.now_s += late_s
        bench.device.tick(bench.now_s)
        assert bench.now_s < 60
    assert bench.body.pose[0] == pytest.approx(0.3, abs=0.004)


def test_a_base_that_is_left_stops_and_is_free_for_another_host() -> None:
    bench = Bench()
    bench.say(Verb.MOVE, 1, *MOVE)
    bench.wait(0.5)
    assert bench.say(Verb.BYE, 0).code is Code.OK
    assert not bench.firmware.is_busy
    assert bench.say(Verb.MOVE, 2, *MOVE).code is Code.LEASE
    assert bench.greet(host=78).lease == 43


def test_tracks_that_skid_turn_less_than_they_count() -> None:
    now = [0.0]
    body = free_vehicle(lambda: now[0], track_factor=1.2)
    body.drive(-0.1, 0.1)
    now[0] = 2.0
    left_m, right_m = body.travel_m()
    assert body.pose[2] == pytest.approx((right_m - left_m) / 0.24 / 1.2)
    assert math.degrees(body.pose[2]) == pytest.approx(math.degrees((right_m - left_m) / 0.24) / 1.2)


orders = st.tuples(st.integers(1, 6), st.sampled_from([Verb.MOVE, Verb.VEL, Verb.STOP]), st.integers(1, 8))


@given(st.lists(orders, max_size=30), st.integers(0, 2**16))
def test_whatever_comes_again_or_late_no_order_is_carried_out_twice(
    said: list[tuple[int, Verb, int]], pause: int
) -> None:
    bench = Bench()
    newest, carried_out = 0, 0
    for tag, verb, _ in said:
        numbers = {Verb.MOVE: (100, 100, 1000), Verb.VEL: (1000, 1000, 100), Verb.STOP: ()}[verb]
        code = bench.say(verb, tag, *numbers).code
        if tag > newest:
            assert code is Code.OK
            newest, carried_out = tag, carried_out + 1
        assert bench.firmware.executed == carried_out


def test_a_greeting_of_the_lease_holder_keeps_the_lease_and_takes_its_watchdog_time() -> None:
    bench = Bench()
    assert bench.say(Verb.VEL, 1, 100_000, 100_000, 10_000).code is Code.OK
    assert bench.greet(watchdog_ms=1500).lease == bench.lease
    assert bench.say(Verb.HELLO, 1, 1, 100, 78, lease=0).code is Code.BUSY
    bench.wait(1.4, polled=False)
    assert bench.poll().state == State.MOVING
    bench.wait(1.5 + 2 * TICK_S, polled=False)
    assert bench.say(Verb.STAT, 9).code is Code.LEASE
    assert not bench.device.is_busy
