"""plugins/roomba: travel that was lost with a reply."""

from __future__ import annotations

import pytest

from plugins.roomba.gaps import TravelGaps

CRUISE = (0.3, 0.3)


def cruising() -> TravelGaps:
    """Return the gaps of a Roomba that goes at 0.3 m/s, and was read at 0.1 s last."""
    gaps = TravelGaps()
    gaps.ask(0.1)
    gaps.answer((0.03, 0.03), CRUISE)
    return gaps


def test_without_a_lost_reply_nothing_is_added() -> None:
    gaps = cruising()
    gaps.ask(0.2)
    assert gaps.answer((0.03, 0.03), CRUISE) == (0.0, 0.0)


def test_a_lost_question_has_begun_no_counter_anew() -> None:
    gaps = cruising()
    gaps.ask(0.2)
    gaps.ask(0.3)
    assert gaps.answer((0.06, 0.06), CRUISE) == (0.0, 0.0)


@pytest.mark.parametrize(("counted_m", "missing_m"), [(0.03, 0.06), (0.06, 0.03), (0.09, 0.0)])
def test_of_several_it_is_the_one_that_fits(counted_m: float, missing_m: float) -> None:
    gaps = cruising()
    for ask_s in (0.2, 0.3, 0.4):
        gaps.ask(ask_s)
    assert gaps.answer((counted_m, counted_m), CRUISE) == pytest.approx((missing_m, missing_m))


def test_each_wheel_has_its_own() -> None:
    gaps = TravelGaps()
    gaps.ask(0.1)
    gaps.answer((-0.02, 0.02), (-0.2, 0.2))
    gaps.ask(0.2)
    gaps.ask(0.3)
    assert gaps.answer((-0.02, 0.02), (-0.2, 0.2)) == pytest.approx((-0.02, 0.02))


def test_a_command_that_was_not_heard_adds_nothing() -> None:
    gaps = TravelGaps()
    for ask_s in (0.1, 0.2, 0.3):
        gaps.ask(ask_s)
    assert gaps.answer((0.0, 0.0), CRUISE) == (0.0, 0.0)
