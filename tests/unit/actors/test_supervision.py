from __future__ import annotations

import pytest

from eal_actors.actors.supervision import BackOff, Restart, RestartIntensity


def test_back_off_grows_up_to_its_longest() -> None:
    back_off = BackOff(initial_s=0.1, factor=2.0, longest_s=0.5)
    assert [back_off.delay_s(n) for n in range(5)] == [0.1, 0.2, 0.4, 0.5, 0.5]


def test_three_restarts_in_five_seconds_are_allowed_and_the_fourth_is_not() -> None:
    intensity = RestartIntensity(max_restarts=3, window_s=5.0)
    assert [intensity.next_delay_s(t) for t in (0.0, 1.0, 2.0, 4.9)] == [0.1, 0.2, 0.4, None]


def test_old_restarts_are_forgotten() -> None:
    intensity = RestartIntensity(max_restarts=3, window_s=5.0)
    delays = [intensity.next_delay_s(t) for t in (0.0, 1.0, 2.0, 5.0, 6.0, 7.0)]
    assert None not in delays
    assert intensity.next_delay_s(7.5) is None


@pytest.mark.parametrize(
    ("restart", "crashed", "wanted"),
    [
        (Restart.PERMANENT, True, True),
        (Restart.PERMANENT, False, True),
        (Restart.TRANSIENT, True, True),
        (Restart.TRANSIENT, False, False),
        (Restart.TEMPORARY, True, False),
        (Restart.TEMPORARY, False, False),
    ],
)
def test_who_is_restarted(restart: Restart, crashed: bool, wanted: bool) -> None:
    assert restart.applies(crashed=crashed) is wanted
