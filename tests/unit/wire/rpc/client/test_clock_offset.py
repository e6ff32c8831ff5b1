from __future__ import annotations

import math

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from eal_actors.kernel.errors import ProtocolError, UnavailableError
from eal_actors.wire.rpc.client.clock_offset import ClockTracker
from eal_actors.wire.rpc.freshness import MAX_DRIFT

WAYS_S = st.sampled_from([0.0, 1e-4, 0.002, 0.05, 1.5])
SIZE = 4


class OffsetMachine(RuleBasedStateMachine):
    """Against two simulated clocks that drift, and the best of the last pings looked up in a plain list."""

    def __init__(self) -> None:
        super().__init__()
        self.tracker = ClockTracker(SIZE)
        self.run = 1
        self.true_s = 0.0
        self.pings: list[tuple[float, float, float]] = []

    @initialize(
        rate=st.sampled_from([1 - MAX_DRIFT * 0.999, 1.0, 1 + MAX_DRIFT * 0.999]),
        ahead_s=st.floats(-1e6, 1e6),
    )
    def choose_clocks(self, rate: float, ahead_s: float) -> None:
        self.rate, self.ahead_s = rate, ahead_s

    def robot_s(self) -> float:
        return self.true_s * self.rate + self.ahead_s

    @rule(there_s=WAYS_S, held_s=WAYS_S, back_s=WAYS_S)
    def ping(self, there_s: float, held_s: float, back_s: float) -> None:
        sent_s = self.true_s
        self.true_s += there_s
        received_s = self.robot_s()
        self.true_s += held_s
        replied_s = self.robot_s()
        self.true_s += back_s
        self.tracker.learn(f"run {self.run}", sent_s, received_s, replied_s, self.true_s)
        round_trip_s = (self.true_s - sent_s) - (replied_s - received_s)
        middle_s = ((received_s - sent_s) + (replied_s - self.true_s)) / 2
        self.pings = [*self.pings, (sent_s, middle_s, round_trip_s)][-SIZE:]

    @rule(duration_s=st.sampled_from([0.01, 1.0, 600.0]))
    def pass_time(self, duration_s: float) -> None:
        self.true_s += duration_s

    @rule()
    def restart_the_robot(self) -> None:
        self.run += 1
        self.pings = []

    @rule(later_s=st.sampled_from([0.0, 5.0]))
    def estimate(self, later_s: float) -> None:
        at_s = self.true_s + later_s
        if not self.pings:
            return
        bounds = [max(round_trip_s, 0) / 2 + MAX_DRIFT * (at_s - sent_s) for sent_s, _, round_trip_s in self.pings]
        found = self.tracker.known()
        assert found.error_s(at_s) == pytest.approx(min(bounds), abs=1e-12)
        best = [ping[1] for ping, bound in zip(self.pings, bounds, strict=True) if bound <= found.error_s(at_s) + 1e-12]
        assert found.offset_s in best

    @invariant()
    def the_truth_is_within_the_bound(self) -> None:
        if self.pings:
            found = self.tracker.known()
            assert abs(self.robot_s() - self.true_s - found.offset_s) <= found.error_s(self.true_s) + 1e-8


OffsetMachine.TestCase.settings = settings(max_examples=60, stateful_step_count=20, deadline=None)
TestOffset = OffsetMachine.TestCase


def test_half_the_round_trip_is_the_error_and_the_middle_the_offset() -> None:
    found = ClockTracker().learn("run", 10.0, 1010.25, 1010.75, 11.0)
    assert (found.offset_s, found.error_s(10.0)) == (1000.0, 0.25)
    assert found.error_s(110.0) == pytest.approx(0.25 + 100 * MAX_DRIFT)


def test_a_good_ping_beats_newer_ones_until_drift_has_eaten_its_lead() -> None:
    tracker = ClockTracker()
    tracker.learn("run", 0.0, 5.0, 5.0, 0.0)
    assert tracker.learn("run", 10.0, 15.0, 15.0, 10.02).error_s(10.02) == pytest.approx(10.02 * MAX_DRIFT)
    best = tracker.learn("run", 100.0, 105.0, 105.0, 100.02)
    assert best.error_s(100.02) == pytest.approx(0.01 + 0.02 * MAX_DRIFT)


def test_a_clock_that_jumped_is_noticed_by_the_next_ping() -> None:
    tracker = ClockTracker()
    tracker.learn("run", 0.0, 5.0, 5.0, 0.001)
    found = tracker.learn("run", 1.0, 3.0, 3.0, 1.5)
    assert abs(found.offset_s - 2.0) <= found.error_s(1.5)


@pytest.mark.parametrize(
    "readings",
    [
        (1.0, 5.0, 5.0, 0.5),
        (0.0, 5.0, 4.0, 1.0),
        (0.0, 5.0, 7.0, 1.0),
        (0.0, math.nan, 5.0, 1.0),
        (0.0, math.inf, math.inf, 1.0),
        (0.0, 5.0, 5.0, math.inf),
        (-math.inf, 5.0, 5.0, 1.0),
    ],
)
def test_readings_that_no_clocks_give_are_refused(readings: tuple[float, float, float, float]) -> None:
    tracker = ClockTracker()
    with pytest.raises(ProtocolError, match="are impossible"):
        tracker.learn("run", *readings)
    with pytest.raises(UnavailableError, match="no ping was answered"):
        tracker.known()
