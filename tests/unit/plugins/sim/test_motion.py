"""The pure part of plugins/sim: trapezoids, moves, drives, and what wheels make of them."""

import math

import numpy as np
import pytest

from plugins.sim.models import MAKES, Make
from plugins.sim.motion import Move, SimWheels, Trapezoid, WheelOdometer, moved
from plugins.sim.velocity_drive import VelocityDrive

TICK_S = 0.02


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
    move = Move.straight(make, -length_m, 0.3, tick_s)
    planned_s = move.remaining_s
    steps = []
    while not move.is_over:
        left_m, right_m = move.step()
        assert left_m == right_m <= 0
        steps.append(-left_m)
    assert sum(steps) == pytest.approx(length_m, abs=1e-12)
    assert len(steps) * tick_s == pytest.approx(planned_s)
    assert move.remaining_s == 0
    assert max(steps, default=0.0) <= 0.3 * tick_s + 1e-12
    assert max(abs(np.diff([0.0, *steps, 0.0]))) <= make.acceleration_m_s2 * tick_s**2 * 1.001 + 1e-12


@pytest.mark.parametrize("degrees", [90, -45, 3600])
def test_a_turn_moves_the_wheels_against_each_other(degrees: float) -> None:
    make = MAKES["evbot3"]
    move = Move.turn(make, math.radians(degrees), 1.0, 0.02)
    left_m = right_m = 0.0
    while not move.is_over:
        left_step_m, right_step_m = move.step()
        left_m, right_m = left_m + left_step_m, right_m + right_step_m
    assert right_m == -left_m
    assert (right_m - left_m) / make.track_m == pytest.approx(math.radians(degrees))


@pytest.mark.parametrize("tick_s", [0.02, 1 / 30])
@pytest.mark.parametrize("target_m_s", [0.3, -0.25, 0.001])
def test_a_drive_reaches_its_speed_with_the_makes_acceleration(target_m_s: float, tick_s: float) -> None:
    make = MAKES["evbot2"]
    drive = VelocityDrive(make, (0.0, 0.1), (target_m_s, target_m_s), None, tick_s)
    ticks = 100
    left_m, right_m = (sum(travels) for travels in zip(*(drive.step() for _ in range(ticks)), strict=True))
    assert drive.speeds_m_s == (target_m_s, target_m_s)
    for travel_m, start_m_s in ((left_m, 0.0), (right_m, 0.1)):
        ramp_s = abs(target_m_s - start_m_s) / make.acceleration_m_s2
        assert travel_m == pytest.approx(target_m_s * ticks * tick_s - (target_m_s - start_m_s) * ramp_s / 2)
    assert not drive.is_over
    assert drive.remaining_s == math.inf


def test_a_drive_ends_at_rest_after_its_time() -> None:
    drive = VelocityDrive(MAKES["roomba"], (0.0, 0.0), (0.4, -0.4), 1.0, TICK_S)
    assert drive.remaining_s == pytest.approx(1.0)
    left_m, ticks = 0.0, 0
    while not drive.is_over:
        left_m, ticks = left_m + drive.step()[0], ticks + 1
    assert ticks * TICK_S == pytest.approx(1.5)  # 0.5 s to speed up and to slow down
    assert left_m == pytest.approx(0.4)
    assert drive.remaining_s == 0


def test_wheels_without_errors_travel_what_is_commanded_and_draw_nothing() -> None:
    generator = np.random.default_rng(1)
    make = MAKES["roomba"].without_errors()
    ahead_m, turn_rad = SimWheels(make, generator).travel(0.25, -0.5)
    assert (ahead_m, turn_rad) == (-0.125, -0.75 / make.track_m)
    assert generator.random() == np.random.default_rng(1).random()


@pytest.mark.parametrize("make", MAKES.values(), ids=lambda make: make.name)
def test_wheels_count_whole_steps_and_keep_the_rest(make: Make) -> None:
    wheels = SimWheels(make, np.random.default_rng(1))
    step_m = make.encoder_step_m
    for _ in range(7):
        wheels.travel(0.3 * step_m, -0.3 * step_m)
    assert wheels.counted_m == pytest.approx((2 * step_m, -3 * step_m))
    assert wheels.turned_m == pytest.approx(2.1 * step_m)
    wheels.travel(0.9 * step_m, 0.1 * step_m)
    assert wheels.counted_m == pytest.approx((3 * step_m, -2 * step_m))


@pytest.mark.parametrize("ticks", [1, 7, 50])
@pytest.mark.parametrize("make", MAKES.values(), ids=lambda make: make.name)
def test_the_scatter_of_the_wheels_depends_on_the_distance_alone(make: Make, ticks: int) -> None:
    """Whatever the number of ticks, forward and back."""
    wheels, step_m = SimWheels(make, np.random.default_rng(1)), 2.0 / ticks
    ends = np.array(
        [np.sum([wheels.travel(step_m, sign * step_m) for _ in range(ticks)], axis=0) for sign in (1, -1) * 200]
    )
    middle_m, turned_rad = ends[::2, 0].std(), ends[::2, 1].std()
    assert middle_m == pytest.approx(make.errors.scatter_m, rel=0.2)  # sqrt(2 m) of each of two wheels, halved
    assert turned_rad == pytest.approx(2 * make.errors.scatter_m / make.track_m / make.errors.track_factor, rel=0.2)
    assert ends[1::2, 0].std() == pytest.approx(make.errors.scatter_m, rel=0.2)


def test_dead_reckoning_follows_arcs() -> None:
    reckoning = WheelOdometer(0.25, (1.0, 1.0))
    reckoning.follow((1.0, 1.0 + 0.25 * math.pi / 2))  # a quarter round the left wheel
    assert reckoning.pose == pytest.approx((0.125, 0.125, math.pi / 2))
    reckoning.pose = (5.0, 5.0, 0.0)
    reckoning.follow((2.0, 2.0 + 0.25 * math.pi / 2))
    assert reckoning.pose == pytest.approx((6.0, 5.0, 0.0))


@pytest.mark.parametrize("turn_rad", [0.0, 1e-12, 1e-8, 1e-3, 2.0])
def test_moved_goes_along_an_arc(turn_rad: float) -> None:
    x_m, y_m, yaw_rad = moved((1.0, 2.0, 0.0), 0.5, turn_rad)
    assert yaw_rad == turn_rad
    if turn_rad:
        radius_m = 0.5 / turn_rad
        assert (x_m - 1, y_m - 2) == pytest.approx(
            (radius_m * math.sin(turn_rad), 2 * radius_m * math.sin(turn_rad / 2) ** 2), abs=1e-15
        )
    else:
        assert (x_m, y_m) == (1.5, 2.0)
