"""plugins/roomba: counts that a damaged reply has changed, and travel that was lost with a reply."""

from __future__ import annotations

import pytest

from plugins.roomba.predicted_wheels import Travel
from plugins.roomba.travel import TravelJudge

POLL_S = 0.05
CRUISE = (0.3, 0.3)


class Bench:
    """The judge of a Roomba that drives at a constant speed, and is read at a constant rate."""

    def __init__(self, speeds_m_s: tuple[float, float] = CRUISE) -> None:
        self.judge = TravelJudge(0.02)
        self.judge.command(speeds_m_s, 0.0)
        self.judge.begin(0.0, speeds_m_s)
        self.now_s = 0.0

    def lose(self, count: int = 1, *, is_reset: bool = True) -> None:
        """Lose replies, or else requests."""
        for _ in range(count):
            self.now_s += POLL_S
            self.judge.ask(self.now_s)
            if is_reset:
                self.judge.lose()

    def read(self, ahead_m: float, arc_m: float = 0.0) -> tuple[Travel, str]:
        self.now_s += POLL_S
        self.judge.ask(self.now_s)
        judgement = self.judge.answer(self.now_s, 0.0, Travel(ahead_m, arc_m))
        return judgement.travel, "suspect" if judgement.is_suspect else "false" if judgement.is_false else ""


def test_a_count_that_fits_is_believed() -> None:
    bench = Bench()
    assert [bench.read(ahead_m) for ahead_m in (0.015, 0.014, 0.016)] == [
        (Travel(ahead_m, 0.0), "") for ahead_m in (0.015, 0.014, 0.016)
    ]
    assert bench.judge.doubt == (0.0, 0.0)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_what_is_lost_with_replies_is_made_up_for(count: int) -> None:
    bench = Bench()
    bench.lose(count)
    travel, verdict = bench.read(0.015)
    assert verdict == ""
    assert travel.ahead_m == pytest.approx(0.015 * (count + 1), abs=3e-4)
    assert 0 < bench.judge.doubt.ahead_m < 0.001 * count


def test_what_is_lost_after_a_count_that_came_late_is_within_the_doubt() -> None:
    bench = Bench()
    bench.now_s += POLL_S
    bench.judge.ask(bench.now_s)
    assert bench.judge.answer(bench.now_s, 0.1, Travel(0.045, 0.0)).travel.ahead_m == 0.045  # taken 0.1 s late
    bench.lose(3)
    travel, _ = bench.read(0.015)
    assert (
        abs(travel.ahead_m - 0.030) <= bench.judge.doubt.ahead_m
    )  # 0.25 s of travel in all, of which 0.15 s are counted


def test_what_standing_wheels_lost_while_they_turned_is_in_doubt() -> None:
    bench = Bench((0.0, 0.0))
    bench.lose()
    bench.read(0.002, 0.001)  # a damaged stop has set it going: 8 mm of arc were lost
    assert bench.judge.doubt.arc_m >= 0.008


def test_a_lost_request_has_not_reset_the_counts() -> None:
    bench = Bench()
    bench.lose(is_reset=False)
    assert bench.read(0.030) == (Travel(0.030, 0.0), "")


@pytest.mark.parametrize("bit", range(4, 15))
@pytest.mark.parametrize("is_arc", [False, True])
def test_a_flipped_bit_is_suspect_and_replaced_when_the_next_count_fits(bit: int, is_arc: bool) -> None:
    bench = Bench()
    false_m = ((0 if is_arc else 15) ^ 1 << bit) / 1000
    assert bench.read(*((0.015, false_m) if is_arc else (false_m, 0.0))) == (Travel(0.0, 0.0), "suspect")
    travel, verdict = bench.read(0.015)
    assert verdict == ""
    doubt = bench.judge.doubt
    assert abs(travel.ahead_m - 0.030) <= doubt.ahead_m + 0.001
    assert abs(travel.arc_m) <= doubt.arc_m + 0.001


def test_wheels_that_stop_are_believed_the_second_time() -> None:
    bench = Bench()
    assert bench.read(0.0)[1] == "suspect"
    assert bench.read(0.0) == (Travel(0.0, 0.0), "")


def test_two_counts_in_a_row_that_cannot_be_true_are_false() -> None:
    bench = Bench()
    assert bench.read(-0.5)[1] == "suspect"
    assert bench.read(0.5)[1] == "false"


def test_the_acceleration_is_learnt_from_two_starts_that_agree() -> None:
    bench = Bench((0.0, 0.0))
    factors: list[float] = []
    for _ in range(2):
        bench.judge.begin(bench.now_s)  # from rest
        bench.judge.command((0.0, 0.0), bench.now_s)
        for _ in range(2):
            bench.read(0.0)
        bench.judge.command(CRUISE, bench.now_s)
        for ahead_m in (0.001, 0.005, 0.007, 0.011, 0.014, 0.015):  # at 1.2 m/s2
            bench.read(ahead_m)
        factors.append(bench.judge.model.factor)
    assert factors[1] < 1.6 < factors[0]
    assert bench.judge.model.acceleration_m_s2 == pytest.approx(1.2, rel=0.3)


def test_a_command_that_came_late_is_predicted_from_then_on() -> None:
    bench = Bench((0.0, 0.0))
    bench.read(0.0)
    bench.judge.command(CRUISE, bench.now_s)
    begun_s = bench.now_s
    bench.judge.model.delay(begun_s, begun_s + 0.1, has_come=True)
    assert bench.judge.model.predict(begun_s, begun_s + 0.1).ahead_m == 0.0
    assert bench.judge.model.predict(begun_s, begun_s + 0.2).ahead_m == pytest.approx(0.004)  # 0.8 m/s2


def test_commands_that_may_not_have_come_yet_add_to_what_is_unknown() -> None:
    bench = Bench((0.0, 0.0))
    bench.read(0.0)
    begun_s = bench.now_s
    bench.judge.command(CRUISE, begun_s)
    bench.judge.model.delay(begun_s, begun_s + 0.5, has_come=False)
    predicted = bench.judge.model.predict(begun_s, begun_s + 0.5)
    assert bench.judge.model.unknown(begun_s, begun_s + 0.5).ahead_m == pytest.approx(predicted.ahead_m)
