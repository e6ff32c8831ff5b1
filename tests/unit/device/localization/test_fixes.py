"""Fixes: consistency of the filter, late fixes, fixes that jump, a robot that was carried, threads."""

from __future__ import annotations

import math
import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from eal_actors.device.localization.localizer import UNKNOWN, FixOutcome, Localizer
from eal_actors.device.localization.odometry_noise import OdometryNoise
from eal_actors.device.localization.pose_estimate import PoseEstimate, diagonal
from eal_actors.kernel.errors import ArgumentError
from tests.unit.device.localization.driven import TICK_S, DrivenRobot

NOISE = OdometryNoise(0.25, 0.002, 0.0, 0.01, 0.02, 0.02)
SEEDS = range(20)
FIX_TICKS = 5
LATE_TICKS = 7


def tracked(seed: int, ticks: int, late_ticks: int = LATE_TICKS) -> tuple[DrivenRobot, Localizer, list[FixOutcome]]:
    robot = DrivenRobot(NOISE, seed)
    localizer, outcomes = robot.localizer(), []
    for tick in range(ticks):
        robot.drive()
        localizer.odometry(*robot.counted, robot.now_s)
        if tick % FIX_TICKS == 0 and tick >= late_ticks:
            outcomes.append(localizer.fix(robot.fix(late_ticks)))
    return robot, localizer, outcomes


def test_the_filter_is_consistent_with_late_fixes() -> None:
    """The mean of the normalised error over 20 seeds is within the 99.8 % bounds of chi-square with 60 degrees."""
    found = []
    for seed in SEEDS:
        robot, localizer, outcomes = tracked(seed, 300)
        assert set(outcomes) == {FixOutcome.APPLIED}, f"seed {seed}"
        found.append(robot.nees(localizer.estimate(robot.now_s)))
    assert 30.3 / 20 < float(np.mean(found)) < 99.6 / 20, found


def test_the_filter_is_consistent_with_odometry_alone() -> None:
    found = []
    for seed in SEEDS:
        robot = DrivenRobot(NOISE, seed)
        localizer = robot.localizer()
        for _ in range(200):
            robot.drive()
            localizer.odometry(*robot.counted, robot.now_s)
        found.append(robot.nees(localizer.estimate(robot.now_s)))
    assert 30.3 / 20 < float(np.mean(found)) < 99.6 / 20, found


def test_a_late_fix_counts_for_its_own_time_and_not_for_its_arrival() -> None:
    """A robot at 0.4 m/s is 56 mm further on when a fix of 140 ms ago arrives."""
    errors_m: list[float] = []
    naive_m: list[float] = []
    for seed in SEEDS[:5]:
        for is_naive, found_m in ((False, errors_m), (True, naive_m)):
            robot = DrivenRobot(OdometryNoise(0.25, 0.0005, 0.0, 0.0, 0.0, 0.0), seed)
            robot.speed_m_s, robot.changes = 0.4, False
            localizer = robot.localizer()
            for tick in range(150):
                robot.drive()
                localizer.odometry(*robot.counted, robot.now_s)
                if tick % FIX_TICKS == 0:
                    fix = robot.fix(LATE_TICKS)
                    localizer.fix(replace(fix, stamp_s=robot.now_s) if is_naive else fix)
            found_m.append(float(np.hypot(*robot.error(localizer.estimate(robot.now_s))[:2])))
    assert max(errors_m) < 0.005 < 0.03 < min(naive_m), (errors_m, naive_m)


def test_fixes_in_any_order_give_the_same_estimate() -> None:
    robot = DrivenRobot(NOISE, 3)
    fixes = []
    in_order, reversed_order = robot.localizer(), robot.localizer()
    for tick in range(60):
        robot.drive()
        for localizer in (in_order, reversed_order):
            localizer.odometry(*robot.counted, robot.now_s)
        if tick % FIX_TICKS == 0:
            fixes.append(robot.fix())
            in_order.fix(fixes[-1])
    for fix in reversed(fixes):
        assert reversed_order.fix(fix) is FixOutcome.APPLIED
    one, other = in_order.estimate(robot.now_s), reversed_order.estimate(robot.now_s)
    assert one.numbers() == pytest.approx(other.numbers(), abs=2e-4)


def test_a_fix_that_is_ahead_of_the_odometry_waits_for_it() -> None:
    localizer = Localizer("rob")
    localizer.attach(NOISE)
    localizer.odometry(0.0, 0.0, 0.0, 1.0)
    fix = PoseEstimate(0.105, 0.001, 0.0, diagonal(0.001, 0.001), 1.5)
    assert localizer.fix(fix) is FixOutcome.PENDING
    localizer.odometry(0.2, 0.0, 0.0, 2.0)
    assert localizer.estimate(1.5).x_m == pytest.approx(0.105, abs=0.002)
    with pytest.raises(ArgumentError, match=r"3\.000 s ahead of its odometry: its stamp_s must be the time"):
        localizer.fix(replace(fix, stamp_s=5.0))


def test_a_fix_that_came_by_two_ways_counts_once() -> None:
    robot = DrivenRobot(NOISE, 1)
    once, twice = robot.localizer(), robot.localizer()
    for tick in range(40):
        robot.drive()
        fix = robot.fix()
        for localizer in (once, twice):
            localizer.odometry(*robot.counted, robot.now_s)
            if tick % FIX_TICKS == 0:
                localizer.fix(fix)
        if tick % FIX_TICKS == 0:
            assert twice.fix(replace(fix, stamp_s=fix.stamp_s - 0.003)) is FixOutcome.REPEATED
    assert once.estimate(1.0) == twice.estimate(1.0)


def test_a_fix_that_jumps_is_refused_and_reported_once(capsys: pytest.CaptureFixture[str]) -> None:
    robot, localizer, _ = tracked(2, 200)
    before = localizer.estimate(robot.now_s)
    for _ in range(3):
        wrong = robot.fix()
        wrong = replace(wrong, x_m=wrong.x_m + robot.random.uniform(0.3, 2.0))
        assert localizer.fix(wrong) is FixOutcome.REFUSED
    assert localizer.estimate(robot.now_s) == before
    said = capsys.readouterr()
    assert (said.out + said.err).count("a fix is refused") == 1


def test_a_robot_that_was_carried_is_localised_again(capsys: pytest.CaptureFixture[str]) -> None:
    robot, localizer, _ = tracked(4, 200, late_ticks=0)
    x_m, y_m, yaw_rad = robot.truth
    robot.truth = x_m + 1.5, y_m - 0.7, yaw_rad + 2.0
    outcomes = []
    for tick in range(60):
        robot.drive()
        localizer.odometry(*robot.counted, robot.now_s)
        if tick % FIX_TICKS == 0:
            outcomes.append(localizer.fix(robot.fix()))
        if outcomes[-1] is FixOutcome.RELOCALISED:
            break
    assert outcomes == [FixOutcome.REFUSED] * 4 + [FixOutcome.RELOCALISED]
    estimate = localizer.estimate(robot.now_s)
    assert np.hypot(*robot.error(estimate)[:2]) < 0.02
    assert estimate.position_std_m > 2 * robot.fix_std[0]
    assert "localised again from fixes" in "".join(capsys.readouterr())
    robot.drive()
    localizer.odometry(*robot.counted, robot.now_s)
    assert localizer.fix(robot.fix()) is FixOutcome.APPLIED


def test_wrong_fixes_that_do_not_agree_never_move_the_estimate() -> None:
    robot, localizer, _ = tracked(5, 200)
    before = localizer.estimate(robot.now_s)
    for _ in range(30):
        robot.now_s += 0.1
        localizer.odometry(*robot.counted, robot.now_s)
        wrong = replace(robot.fix(), x_m=robot.random.uniform(5, 9), stamp_s=robot.now_s)
        assert localizer.fix(wrong) is FixOutcome.REFUSED
    assert localizer.estimate(robot.now_s).numbers() == before.numbers()


def test_right_fixes_among_consistent_wrong_ones_keep_the_estimate() -> None:
    """Two trackers, one of them displaced by half a metre."""
    robot, localizer, _ = tracked(6, 200, late_ticks=0)
    for tick in range(200):
        robot.drive()
        localizer.odometry(*robot.counted, robot.now_s)
        if tick % FIX_TICKS == 0:
            right, wrong = robot.fix(), robot.fix()
            assert localizer.fix(right) is FixOutcome.APPLIED
            assert localizer.fix(replace(wrong, y_m=wrong.y_m + 0.5)) is FixOutcome.REFUSED
    assert np.hypot(*robot.error(localizer.estimate(robot.now_s))[:2]) < 0.01


def test_the_first_fix_tells_a_robot_whose_start_is_unknown_where_it_is() -> None:
    robot = DrivenRobot(NOISE, 7)
    localizer = robot.localizer()
    localizer.begin_at(0.0, 0.0, 0.0, UNKNOWN)
    robot.truth = robot.past[0] = (-3.0, 2.0, 3.0)
    assert localizer.estimate(0.0).position_std_m > 50
    assert localizer.fix(replace(robot.fix(), stamp_s=0.0)) is FixOutcome.APPLIED
    assert np.hypot(*robot.error(localizer.estimate(0.0))[:2]) < 0.01


def test_a_fix_that_is_too_old_is_refused() -> None:
    robot, localizer, _ = tracked(8, 600)
    assert localizer.fix(replace(robot.fix(), stamp_s=robot.now_s - 9.0)) is FixOutcome.REFUSED


def test_a_tracked_robot_calibrates_its_odometry() -> None:
    """After 15 s of fixes, ten seconds without any cost less than half of what they cost at first."""
    fresh_m: list[float] = []
    tracked_m: list[float] = []
    for seed in SEEDS[:5]:
        for errors_m, ticks in ((fresh_m, 0), (tracked_m, 750)):
            robot, localizer, _ = tracked(seed, ticks)
            if not ticks:
                localizer.fix(robot.fix())
            for _ in range(500):
                robot.drive()
                localizer.odometry(*robot.counted, robot.now_s)
            errors_m.append(float(np.hypot(*robot.error(localizer.estimate(robot.now_s))[:2])))
    assert np.median(tracked_m) < np.median(fresh_m) / 2, (tracked_m, fresh_m)


def test_any_thread_may_use_a_localizer() -> None:
    """A driver, two trackers and two readers at once: no error, and the estimate stays at the truth."""
    robot = DrivenRobot(NOISE, 9)
    localizer, errors, moved = robot.localizer(), [], threading.Event()
    fixes: list[list[PoseEstimate]] = [[], []]

    def guarded(function: Any) -> None:
        try:
            function()
        except Exception as error:  # noqa: BLE001
            errors.append(error)

    def read() -> None:
        while not moved.is_set():
            estimate = localizer.estimate(math.inf)
            assert all(map(math.isfinite, estimate.numbers()))
            assert estimate.covariance[0][0] > 0

    def correct(own: list[PoseEstimate]) -> None:
        while not (moved.is_set() and not own):
            if own:
                localizer.fix(own.pop(0))

    threads = [threading.Thread(target=guarded, args=(read,)) for _ in range(2)]
    threads += [threading.Thread(target=guarded, args=(lambda own=own: correct(own),)) for own in fixes]
    for thread in threads:
        thread.start()
    for tick in range(400):
        robot.drive()
        localizer.odometry(*robot.counted, robot.now_s)
        if tick % FIX_TICKS == 0:
            fixes[tick % 2].append(robot.fix())
    moved.set()
    for thread in threads:
        thread.join(60)
        assert not thread.is_alive()
    assert not errors
    assert np.hypot(*robot.error(localizer.estimate(robot.now_s))[:2]) < 0.01
    assert math.isclose(robot.now_s, 400 * TICK_S)


def test_a_pose_is_shown_with_its_numbers_rounded_and_its_uncertainty() -> None:
    shown = repr(PoseEstimate(-1.50024960, -6.49e-6, 1.56874999, diagonal(0.0013, 0.0336), 39.96000001))
    assert shown == (
        "PoseEstimate(x_m=-1.5002, y_m=0.0, yaw_rad=1.5687, position_std_m=0.0013, yaw_std_rad=0.034, "
        "stamp_s=39.96, frame_id='map')"
    )
