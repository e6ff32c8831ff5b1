"""ProgressWatch and HoldWatch: who comes no nearer, whose pose jumps, and who is held."""

from __future__ import annotations

import math

import pytest

from eal_actors.device.motion.closed_loop import HoldWatch, ProgressWatch
from eal_actors.kernel.errors import LocalizationError


def test_a_robot_that_comes_nearer_is_never_late() -> None:
    watch = ProgressWatch(0.0)
    assert all(watch.update(10 - 0.05 * step, None, 0.5 * step) <= 1.0 for step in range(180))


def test_a_robot_that_oscillates_is_late() -> None:
    watch = ProgressWatch(0.0)
    late_s = [watch.update(1.0 + 0.003 * (step % 2), None, 0.05 * step) for step in range(200)]
    assert late_s[-1] == pytest.approx(0.05 * 199)


def test_a_turn_in_place_counts_as_nearer_but_not_for_ever() -> None:
    watch = ProgressWatch(0.0)
    turn = [math.pi - 0.02 * step for step in range(150)]
    assert max(watch.update(1.0, left_rad, 0.05 * step) for step, left_rad in enumerate(turn)) < 0.1
    for lap in range(1, 10):
        for step, left_rad in enumerate(turn):
            late_s = watch.update(1.0, left_rad, 0.05 * (150 * lap + step))
            watch.update(1.0, None, 0.05 * (150 * lap + step))
    assert late_s > 5.0


def test_a_pose_that_jumps_is_forgiven_five_times() -> None:
    watch = ProgressWatch(0.0)
    for step in range(11):
        watch.update(1.0 if step % 2 == 0 else 2.0, None, 0.05 * step)
    with pytest.raises(LocalizationError, match="6 times"):
        watch.update(2.0, None, 0.6)


def test_a_robot_that_is_held_pauses_and_gives_up() -> None:
    watch = HoldWatch(0.0)
    stands = [watch.must_pause(0.05 * step, is_held=True) for step in range(200)]
    assert not stands[0]
    assert watch.gives_up
    assert 0.6 < sum(stands) / len(stands) < 0.9


def test_a_robot_that_is_held_now_and_then_goes_on() -> None:
    watch = HoldWatch(0.0)
    for step in range(400):
        watch.must_pause(0.05 * step, is_held=step % 80 < 10)
    assert not watch.gives_up
