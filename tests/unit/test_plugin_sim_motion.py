"""The pure part of plugins/sim: trapezoids, motions and wheel errors."""

import math

import numpy as np
import pytest

from plugins.sim.models import MAKES, NO_ERRORS, Make
from plugins.sim.motion import SETTLE_TICKS, Motion, Trapezoid, Wheels


def test_a_long_way_is_a_trapezoid() -> None:
    profile = Trapezoid(1.0, 0.5, 1.0)  # 0.5 s up over 0.125 m, 1.5 s over 0.75 m, 0.5 s down
    assert profile.duration_s == pytest.approx(2.5)
    assert profile.travelled_m(0.5) == pytest.approx(0.125)
    assert profile.travelled_m(2.0) == pytest.approx(0.875)
    assert profile.travelled_m(2.25) == pytest.approx(0.875 + 0.5 * 0.25 - 0.5 * 0.25**2)
    assert profile.travelled_m(2.5) == profile.travelled_m(99.0) == 1.0


def test_a_short_way_is_a_triangle() -> None:
    profile = Trapezoid(0.01, 0.5, 1.0)
    assert profile.duration_s == pytest.approx(0.2)
    assert profile.travelled_m(0.1) == pytest.approx(0.005)


@pytest.mark.parametrize("length_m", [0.0, 1e-9, 0.003, 0.5, 97.3])
@pytest.mark.parametrize("tick_s", [0.02, 1 / 30])
def test_a_motion_counts_its_length_exactly_within_speed_and_acceleration(length_m: float, tick_s: float) -> None:
    make = MAKES["roomba"]
    motion = Motion.straight(make, -length_m, 0.3, tick_s)
    planned_s = motion.remaining_s
    steps = []
    while not motion.is_over:
        left_m, right_m = motion.step()
        assert left_m == right_m <= 0
        steps.append(-left_m)
    assert sum(steps) == pytest.approx(length_m, abs=1e-12)
    assert steps[-SETTLE_TICKS:] == [0.0] * SETTLE_TICKS
    assert len(steps) * tick_s == pytest.approx(planned_s)
    assert motion.remaining_s == 0
    assert max(steps) <= 0.3 * tick_s + 1e-12
    assert max(abs(np.diff([0.0, *steps]))) <= make.acceleration_m_s2 * tick_s**2 * 1.001 + 1e-12


@pytest.mark.parametrize("degrees", [90, -45, 3600])
def test_a_turn_moves_the_wheels_against_each_other(degrees: float) -> None:
    make = MAKES["evbot3"]
    motion = Motion.turn(make, math.radians(degrees), 1.0, 0.02)
    left_m = right_m = 0.0
    while not motion.is_over:
        left_step_m, right_step_m = motion.step()
        left_m, right_m = left_m + left_step_m, right_m + right_step_m
    assert right_m == -left_m
    assert (right_m - left_m) / make.track_m == pytest.approx(math.radians(degrees))


def test_wheels_without_errors_travel_what_is_counted_and_draw_nothing() -> None:
    generator = np.random.default_rng(1)
    assert Wheels(NO_ERRORS, generator, 0.02).travel(0.25, -0.5) == (0.25, -0.5)
    assert generator.random() == np.random.default_rng(1).random()


@pytest.mark.parametrize("make", MAKES.values(), ids=lambda make: make.name)
def test_wheel_errors_stay_small_over_a_long_motion(make: Make) -> None:
    wheels = Wheels(make.errors, np.random.default_rng(1), 0.02)
    wheels.start()
    travels = np.array([wheels.travel(0.01, 0.01) for _ in range(500)]) / 0.01
    assert np.abs(travels - 1).max() < 0.05
    assert travels.std() > 1e-4
    wheels.start()
    assert np.abs(np.array(wheels.travel(0.01, 0.01)) / 0.01 - 1).max() < 0.006


@pytest.mark.parametrize("make", MAKES.values(), ids=lambda make: make.name)
def test_every_make_begins_within_its_reach(make: Make) -> None:
    assert 0 < make.speed_m_s <= make.max_speed_m_s
    assert 0 < make.turn_rate_deg_s <= make.max_turn_rate_deg_s
    assert math.radians(make.max_turn_rate_deg_s) * make.track_m / 2 <= make.max_speed_m_s
