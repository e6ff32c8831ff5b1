"""Motions to a pose that cannot end at their goal: each stops the motors and says why."""

from __future__ import annotations

import math

import pytest

from eal_actors.device.motion.closed_loop import PATIENCE_S
from eal_actors.kernel.errors import (
    ArgumentError,
    BlockedError,
    DeadlineError,
    EALError,
    LocalizationError,
    NotReadyError,
    PreemptedError,
    StoppedError,
)
from tests.motion.rig import TrackedRobot, tracked

WALLED = {
    "version": 1,
    "name": "walled",
    "size_m": [6, 6],
    "obstacles": [{"kind": "wall", "start_m": [0.9, -1.0], "end_m": [0.9, 1.0]}],
}


def assert_stands(it: TrackedRobot) -> None:
    """Assert that the robot does not move any more."""
    it.simulation.advance(0.5)
    before = it.true_pose()
    it.simulation.advance(1.0)
    assert it.true_pose() == before


@pytest.mark.parametrize("kind", ["sim-roomba", "evbot3", "evbot2"])
def test_something_in_the_way_for_ever_is_said(kind: str) -> None:
    with tracked(kind, 0, WALLED) as it:
        it.fix()
        error = it.until_done(it.robot.base.go_to(2.0, 0.0))
        assert isinstance(error, BlockedError), error
        assert f"{PATIENCE_S:g} s" in str(error)
        assert "m from its goal" in str(error)
        assert_stands(it)
        assert it.true_pose()[0] < 0.9


def test_range_sensors_stop_it_before_a_touch() -> None:
    with tracked("sim-roomba", 0, WALLED) as it:
        touched = []
        motion = it.robot.base.go_to(2.0, 0.0)
        while not motion.done():
            it.fix()
            it.simulation.advance(0.1)
            touched.append(it.simulation.is_bumping("body"))
        assert not any(touched)
        assert "ahead" in str(motion.exception())


def test_a_way_that_becomes_free_is_driven_on() -> None:
    with tracked("sim-evbot3", 0) as it:
        it.robot.base.set_velocity(0.0).get()
        motion = it.robot.base.go_to(1.5, 0.0)
        it.until_moving(motion)
        it.simulation.inject("body", motor_left=0.0, motor_right=0.0)
        it.advance_tracked(PATIENCE_S - 1)
        assert not motion.done()
        it.simulation.clear_faults("body")
        assert it.until_done(motion) is None
        assert it.errors(1.5, 0.0, None)[0] < 0.01


def test_too_uncertain_a_pose_stops_it() -> None:
    with tracked("sim-evbot2", 0, calibrated=False) as it:
        it.fix()
        it.is_tracked = False
        it.robot["Base"].set_config("max_uncertainty_m", 0.05).get()
        error = it.until_done(it.robot.base.follow([(1.5, 0.0), (1.5, 1.5), (-1.5, 1.5)]))
        assert isinstance(error, LocalizationError), error
        assert "standard deviation" in str(error)
        assert_stands(it)


def test_a_tracker_that_is_lost_for_a_while_is_no_end() -> None:
    with tracked("sim-evbot3", 0) as it:
        it.fix()
        motion = it.robot.base.go_to(1.5, 0.5, 90)
        it.until_moving(motion)
        it.is_tracked = False
        it.simulation.advance(2.0)
        it.is_tracked = True
        assert it.until_done(motion) is None
        assert it.errors(1.5, 0.5, 90)[0] < 0.01


@pytest.mark.parametrize("kind", ["evbot2", "evbot3"])
def test_a_base_that_is_silent_for_a_while_is_no_end(kind: str) -> None:
    """As behind a busy computer or a slow wire: the firmware stops by itself, and the motion goes on."""
    with tracked(kind, 0) as it:
        it.fix()
        motion = it.robot.base.go_to(1.5, 0.5, 90)
        it.until_moving(motion)
        it.simulation.inject("body", dead=True)
        it.simulation.advance(PATIENCE_S - 1.5)
        assert not motion.done()
        it.simulation.clear_faults("body")
        it.simulation.advance(0.5)
        assert it.until_done(motion) is None
        assert it.errors(1.5, 0.5, 90)[0] < 0.01


def test_a_base_that_stays_silent_is_said() -> None:
    with tracked("evbot3", 0) as it:
        it.fix()
        motion = it.robot.base.go_to(1.5, 0.5)
        it.until_moving(motion)
        it.simulation.inject("body", dead=True)
        it.simulation.advance(PATIENCE_S + 2.0)
        assert isinstance(motion.exception(), NotReadyError), motion.exception()
        assert "does not answer" in str(motion.exception())
        assert_stands(it)


def test_a_robot_that_is_carried_away_comes_back() -> None:
    with tracked("sim-roomba", 0) as it:
        motion = it.robot.base.go_to(1.0, 0.0)
        it.until_moving(motion)
        it.robot["Base"].halt().get()
        assert isinstance(motion.exception(), PreemptedError)
        it.body["TruePose"].set_value([-1.0, 1.0, 2.0]).get()
        it.robot.pose.set(-1.0, 1.0, math.degrees(2.0)).get()
        assert it.until_done(it.robot.base.go_to(1.0, 0.0)) is None
        assert it.errors(1.0, 0.0, None)[0] < 0.01


@pytest.mark.parametrize("kind", ["sim-evbot2", "evbot3", "oi"])
@pytest.mark.parametrize("end", ["halt", "deadline", "stop", "cancel", "newer"])
def test_every_end_in_mid_motion_stops_the_motors(kind: str, end: str) -> None:
    with tracked(kind, 0) as it:
        it.fix()
        motion = it.robot.base.go_to(3.0, 0.0, timeout_s=3.0 if end == "deadline" else 60.0)
        it.until_moving(motion)
        expected: type[EALError] = PreemptedError
        if end == "halt":
            it.robot.base.stop().get()
        elif end == "stop":
            it.robot.stop("test").get()
        elif end == "cancel":
            motion.cancel()
        elif end == "newer":
            it.robot["Base"].send_cmd("s").get()
        else:
            expected = DeadlineError
        error = it.until_done(motion)
        assert isinstance(error, expected) or end == "cancel", error
        assert_stands(it)
        if end == "stop":
            assert isinstance(it.robot.base.go_to(1.0, 0.0).exception(), StoppedError)


@pytest.mark.parametrize(
    ("cmd", "data", "part"),
    [
        ("goto", [math.nan, 0.0], "finite"),
        ("goto", [1.0], "x_m, y_m"),
        ("goto", [1.0, 2.0, 3.0, 4.0], "x_m, y_m"),
        ("goto", None, "needs an argument"),
        ("follow", [1.0, 2.0, 3.0], "(n, 2)"),
        ("follow", [math.inf, 2.0], "finite"),
        ("follow", "here", "(n, 2)"),
    ],
)
def test_a_goal_that_is_none_is_refused(cmd: str, data: object, part: str) -> None:
    with tracked("sim-roomba", 0) as it:
        error = it.robot["Base"].send_cmd(cmd, data).exception()
        assert isinstance(error, ArgumentError)
        assert part in str(error)


def test_the_same_seed_drives_the_same_way() -> None:
    def path(seed: int) -> list[tuple[float, float, float]]:
        with tracked("sim-roomba", seed) as it:
            motion, found = it.robot.base.go_to(0.6, 0.4), []
            while not motion.done():
                it.fix()
                it.simulation.advance(0.1)
                found.append(it.true_pose())
            return found

    seed = 7
    assert path(seed) == path(seed)
