"""The pose estimate of a robot by its odometry."""

from __future__ import annotations

import math

import pytest

from eal_actors.device.localization.localizer import Localizer
from eal_actors.device.localization.odometry_noise import OdometryNoise
from eal_actors.kernel.errors import NotReadyError

NOISE = OdometryNoise(0.25, 0.002, 0.004)


def begun(x_m: float = 0.0, y_m: float = 0.0, yaw_rad: float = 0.0) -> Localizer:
    localizer = Localizer("rob")
    localizer.attach(NOISE)
    localizer.begin_at(x_m, y_m, yaw_rad)
    localizer.odometry(0.0, 0.0, 0.0, 0.0)
    return localizer


def test_without_odometry_no_pose_is_known() -> None:
    with pytest.raises(NotReadyError, match="the pose of rob is unknown: no odometry has arrived yet"):
        Localizer("rob").estimate(0.0)


def test_the_estimate_follows_the_odometry_from_the_start() -> None:
    localizer = begun(2.0, 1.0, math.pi / 2)
    for step in range(1, 101):
        localizer.odometry(0.01 * step, 0.0, 0.0, 0.02 * step)
    estimate = localizer.estimate(2.0)
    assert (estimate.x_m, estimate.y_m, estimate.yaw_rad) == pytest.approx((2.0, 2.0, math.pi / 2))
    assert (estimate.frame_id, estimate.stamp_s) == ("map", 2.0)


def test_a_past_pose_is_interpolated() -> None:
    localizer = begun()
    for step in range(1, 101):
        localizer.odometry(0.01 * step, 0.0, 0.0, 0.02 * step)
    assert localizer.estimate(1.01).x_m == pytest.approx(0.505)
    assert localizer.estimate(1.01).stamp_s == 1.01


def test_the_uncertainty_grows_with_the_distance_and_not_with_the_time() -> None:
    localizer, stds = begun(), []
    for step in range(1, 401):
        localizer.odometry(0.01 * step, 0.0, 0.0, 0.02 * step)
        stds.append(localizer.estimate(math.inf).position_std_m)
    assert stds == sorted(stds)
    assert stds[399] > 2 * stds[199] > 0.01
    localizer.odometry(4.0, 0.0, 0.0, 1000.0)
    assert localizer.estimate(1000.0).position_std_m == stds[-1]


def test_readers_do_not_change_the_estimate_and_its_uncertainty() -> None:
    seldom, often = begun(), begun()
    for step in range(1, 2001):
        angle_rad = 0.005 * step
        pose = math.sin(angle_rad), 1.0 - math.cos(angle_rad), angle_rad
        for localizer in (seldom, often):
            localizer.odometry(*pose, 0.02 * step)
        often.estimate(math.inf)
    one, other = seldom.estimate(math.inf), often.estimate(math.inf)
    assert one.numbers()[:3] == pytest.approx(other.numbers()[:3], abs=1e-6)
    assert one.position_std_m == pytest.approx(other.position_std_m, rel=0.05)
    assert one.yaw_std_rad == pytest.approx(other.yaw_std_rad, rel=0.05)


def test_an_odometry_that_begins_anew_does_not_move_the_robot() -> None:
    localizer = begun()
    localizer.odometry(1.0, 0.0, 0.0, 1.0)
    localizer.restart_odometry(7.0, 7.0, 1.0, 1.0)
    assert localizer.estimate(1.0).x_m == pytest.approx(1.0)
    localizer.attach(NOISE)  # the driver was restarted, and counts from 0
    localizer.odometry(0.0, 0.0, 0.0, 2.0)
    localizer.odometry(0.5, 0.0, 0.0, 2.5)
    assert localizer.estimate(3.0).x_m == pytest.approx(1.5)


def test_a_pose_that_is_set_counts_from_now_on() -> None:
    localizer = begun()
    localizer.odometry(1.0, 0.0, 0.0, 1.0)
    localizer.place(-2.0, 3.0, math.pi)
    localizer.odometry(1.5, 0.0, 0.0, 2.0)
    assert localizer.estimate(2.0).numbers()[:2] == pytest.approx([-2.5, 3.0])


def test_readings_leave_no_trace_in_later_estimates() -> None:
    quiet, read = begun(), begun()
    for step in range(1, 801):
        x_m, y_m, yaw_rad, stamp_s = 0.01 * step, 0.003 * step, 0.002 * step, 0.02 * step
        read.odometry(x_m - 0.005, y_m - 0.0015, yaw_rad - 0.001, stamp_s - 0.01)  # as a driver's refresh adds
        read.estimate(stamp_s)
        for localizer in (quiet, read):
            localizer.odometry(x_m, y_m, yaw_rad, stamp_s)
        if step % 200 == 0:
            assert quiet.estimate(stamp_s) == read.estimate(stamp_s)
