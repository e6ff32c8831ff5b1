"""Robots in one array take the same paths, to the bit, as robots one by one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from eal_actors.device.world import WorldModel
from eal_actors.plugin import WheelCalibration
from plugins.sim import world as world_module
from plugins.sim.faults import FaultSet
from plugins.sim.models import MAKES
from plugins.sim.motion import Move
from plugins.sim.robot import SimRobot
from plugins.sim.world import SimWorld
from tests.manual_clock import ManualClock

ROBOTS, SIZE_M = 12, 9.0
NEVER, ALWAYS = 10**9, 0


def traces(monkeypatch: pytest.MonkeyPatch, least_work: int, seed: int, spacing_m: float) -> list[object]:
    """Return everything that can be seen of robots that drive, turn, follow speeds, stop, break and touch."""
    monkeypatch.setattr(world_module, "LEAST_WORK", least_work)
    chance, clock = np.random.default_rng(seed), ManualClock()
    world = SimWorld(clock, seed, WorldModel(version=1, name="field", size_m=(SIZE_M, SIZE_M)))
    robots = []
    for number in range(ROBOTS):
        make = list(MAKES.values())[number % len(MAKES)]
        start = (number % 4 - 1.5) * spacing_m, (number // 4 - 1.0) * spacing_m, float(chance.uniform(-3, 3))
        robot = world.join(f"robot{number}", make, noise=number % 5 > 0, start=start, charge=1.0 if number else 0.00001)
        with world.lock:
            world.catch_up()
            robot.begin_odometry()
        robots.append(robot)
    seen: list[object] = []
    in_array = 0
    for _ in range(30):
        with world.lock:
            world.catch_up()
            for robot in chance.choice(robots, 4, replace=False):  # type: ignore[arg-type]
                change(world, robot, int(chance.integers(7)), chance)
        clock.advance(float(chance.uniform(0.01, 0.7)))
        with world.lock:
            world.catch_up()
            in_array = max(in_array, sum(robot.free is not None for robot in robots))
            for robot in chance.choice(robots, 5, replace=False):  # type: ignore[arg-type]
                seen += [robot.recent_poses, robot.odometry, robot.travel_m, robot.wheel_speeds_m_s, robot.is_blocked]
                seen += [robot.battery.charge_ah, robot.motion and robot.motion.remaining_s]
            seen += [robot.pose for robot in robots]
    assert (in_array > 0) == (least_work == ALWAYS)
    return seen


def change(world: SimWorld, robot: SimRobot, what: int, chance: np.random.Generator) -> None:
    """Command a robot, or change something about it."""
    empty = robot.battery.is_empty
    if what == 0 and not empty:
        world.start(robot, Move.straight(robot.make, float(chance.uniform(-3, 3)), 0.25, world.tick_s))
    elif what == 1 and not empty:
        world.start(robot, Move.turn(robot.make, float(chance.uniform(-3, 3)), math.radians(60), world.tick_s))
    elif what in (2, 3) and not empty:
        left, right = chance.uniform(-0.3, 0.3, size=2).tolist()
        world.drive(robot, left, right, None if what == 2 else float(chance.uniform(0.1, 2)))
    elif what == 4:
        world.stop(robot)
    elif what == 5:
        robot.faults = FaultSet(motor_left=float(chance.uniform(0.5, 1)))
    else:
        robot.odometry = (1.0, 2.0, 3.0)
        robot.calibration = WheelCalibration(track_factor=float(chance.uniform(0.9, 1.1)), wheel_ratio=1.01)


@pytest.mark.parametrize("spacing_m", [2.0, 0.6])
@pytest.mark.parametrize("seed", range(1))
def test_a_path_is_the_same_in_the_array_and_outside(
    monkeypatch: pytest.MonkeyPatch, seed: int, spacing_m: float
) -> None:
    together = traces(monkeypatch, ALWAYS, seed, spacing_m)
    assert together == traces(monkeypatch, NEVER, seed, spacing_m)
    assert len(together) > 100
