"""The forecast of the look-ahead: paths that continue from live poses, waits, and gaps."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from eal_actors.device.world.model import WorldModel
from eal_actors.lab.lookahead.forecast import PresentState, forecast
from eal_actors.lab.lookahead.script import Script, ScriptStep


def straight(begin_s: float = 0.0, *, has_goal: bool = False) -> Script:
    """Return a script that drives 2 m along x in 10 s, from (0, 0), after a wait."""
    times_s = np.array([0.0, begin_s, begin_s + 10.0])
    step = ScriptStep("steps[0]", 0.0, begin_s, begin_s + 10.0, has_goal)
    return Script([step], times_s, np.array([[0.0, 0, 0], [0.0, 0, 0], [2.0, 0, 0]]))


def running(pose: tuple[float, float, float], script: Script, elapsed_s: float = 0.0) -> PresentState:
    return PresentState(pose, 0.1, script, 0, elapsed_s, is_running=True)


def test_a_relative_motion_goes_where_the_robot_looks() -> None:
    found = forecast({"ann": running((1.0, 1.0, math.pi / 2), straight())}, 10.0, 0.02)
    assert found.poses["ann"][-1] == pytest.approx([1.0, 3.0, math.pi / 2])


def test_a_motion_to_a_place_ends_there() -> None:
    found = forecast({"ann": running((0.1, 0.2, 0.1), straight(has_goal=True))}, 10.0, 0.02)
    assert found.poses["ann"][-1] == pytest.approx([2.0, 0.0, 0.0], abs=1e-9)


def test_the_contact_with_a_robot_that_stands_is_foreseen() -> None:
    robots = {"ann": running((0.0, 0.0, 0.0), straight()), "bob": PresentState((1.2, 0.0, 0.0), 0.1)}
    (finding,) = forecast(robots, 10.0, 0.0).findings
    assert (finding.robot, finding.other, finding.movers) == ("ann", "bob", ("ann",))
    assert finding.in_s == pytest.approx(5.0, abs=0.11)
    assert forecast({**robots, "bob": replace(robots["bob"], pose=(1.2, 0.5, 0.0))}, 10.0, 0.0).findings == ()


def test_a_robot_that_did_not_come_as_far_as_its_time_is_where_its_pose_says() -> None:
    late = replace(running((0.2, 0.0, 0.0), straight(), elapsed_s=6.0), began_at=(0.0, 0.0, 0.0))
    assert forecast({"ann": late}, 5.0, 0.0).poses["ann"][-1, 0] == pytest.approx(1.2, abs=0.05)


def test_a_wait_lasts_until_the_slowest_robot_comes() -> None:
    waits = running((0.0, 0.0, 0.0), straight(begin_s=3.0), elapsed_s=3.0)
    slow = running((0.0, 5.0, 0.0), straight(), elapsed_s=0.0)
    alone = forecast({"ann": waits}, 2.0, 0.0).poses["ann"][-1, 0]
    together = forecast({"ann": replace(waits, elapsed_s=2.0), "bob": slow}, 2.0, 0.0).poses["ann"][-1, 0]
    assert alone == pytest.approx(0.4, abs=0.03)
    assert together == 0.0


def certain(pose: tuple[float, float, float], std_m: float) -> PresentState:
    return PresentState(pose, 0.1, covariance=np.diag([std_m**2, std_m**2, 0.0]))


def test_a_touch_is_as_likely_as_the_poses_are_certain() -> None:
    moves = running((0.0, 0.0, 0.0), straight())
    for std_m, offset_m, likely in ((0.01, 0.1, (0.99, 1.0)), (0.2, 0.19, (0.5, 0.6)), (0.01, 0.215, (0.0, 0.5))):
        robots = {"ann": replace(moves, covariance=np.zeros((3, 3))), "bob": certain((1.2, offset_m, 0.0), std_m)}
        (finding,) = forecast(robots, 10.0, 0.02).findings
        assert likely[0] <= finding.likelihood <= likely[1], (std_m, offset_m)


def test_an_uncertain_direction_makes_a_far_touch_uncertain() -> None:
    def likelihood(away_m: float) -> float:
        ann = replace(running((0.0, 0.0, 0.0), straight()), covariance=np.diag([0.0, 0.0, 0.1**2]))
        (finding,) = forecast({"ann": ann, "bob": PresentState((away_m, 0.1, 0.0), 0.1)}, 10.0, 0.0).findings
        return finding.likelihood

    assert likelihood(0.5) > 0.95 > likelihood(1.9)


def at_wall(*, is_stopped: bool) -> float:
    """Return the likelihood of a touch of the wall at 1.1 m: it stopped the rehearsal, or the step ended there."""
    times_s, poses = np.array([0.0, 5.0, 10.0]), np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 0, 0]])
    step = ScriptStep("steps[0]", 0.0, 0.0, 10.0 if is_stopped else 5.0)
    script = Script([step], times_s, poses, [5.0] if is_stopped else [])
    ann = replace(running((0.0, 0.0, 0.0), script), covariance=np.diag([0.01**2, 0.01**2, 0.0]))
    (finding,) = forecast({"ann": ann}, 8.0, 0.02, WorldModel(version=1, name="hall", size_m=(2.2, 8.0))).findings
    assert finding.other == "a wall"
    return finding.likelihood


def test_a_wall_that_stops_the_rehearsal_is_a_certain_touch() -> None:
    assert at_wall(is_stopped=True) > 0.95
    assert at_wall(is_stopped=False) < 0.6
