"""How far a robot drifts on a long straight way: its yaw spreads with the square root of the distance.

Source: L. Kleeman, "Odometry Error Covariance Estimation for Two Wheel Robot Vehicles", MECSE-95-1, 1995.
"""

from __future__ import annotations

import math
from statistics import pstdev

import pytest

from plugins.sim.models import MAKES, Make, MakeName
from plugins.sim.motion import Move
from plugins.sim.world import SimWorld
from tests.manual_clock import ManualClock
from tests.unit.plugins.sim.rig import arena

SEEDS = 40
ROOM = arena(60.0, 60.0, physics={"rate_hz": 10})


def yaws_rad(model: MakeName, legs_m: list[float]) -> list[float]:
    """Return the true yaw at the end of the legs, for each seed."""
    ends = []
    for seed in range(SEEDS):
        clock = ManualClock()
        world = SimWorld(clock, seed, ROOM)
        robot = world.join("r1", MAKES[model], noise=True, start=(0.0, 0.0, 0.0))
        for leg_m in legs_m:
            with world.lock:
                world.catch_up()
                move = Move.straight(robot.make, leg_m, robot.make.speed_m_s, world.tick_s)
                world.start(robot, move)
            clock.advance(move.remaining_s)
        with world.lock:
            world.catch_up()
            ends.append(robot.pose[2])
    return ends


def degrees_per_root_metre(make: Make) -> float:
    return math.degrees(make.errors.scatter_m * math.sqrt(2) / make.track_m / make.errors.track_factor)


@pytest.mark.parametrize("legs_m", [[1.0], [20.0], [1.0] * 20], ids=["1 m", "20 m", "20 x 1 m"])
def test_yaw_spreads_with_the_root_of_the_distance(legs_m: list[float]) -> None:
    expected_deg = degrees_per_root_metre(MAKES["roomba"]) * math.sqrt(sum(legs_m))
    assert math.degrees(pstdev(yaws_rad("roomba", legs_m))) == pytest.approx(expected_deg, rel=0.3)


@pytest.mark.parametrize(("model", "most_deg"), [("evbot2", 6.0), ("evbot3", 1.5), ("roomba", 1.5)])
def test_no_make_drifts_farther_in_20_m_than_its_drive_explains(model: MakeName, most_deg: float) -> None:
    assert degrees_per_root_metre(MAKES[model]) * math.sqrt(20.0) < most_deg
