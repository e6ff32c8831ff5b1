"""Contacts of robots with walls, boxes and each other."""

from __future__ import annotations

import math
from contextlib import suppress

import pytest

from eal_actors.kernel.errors import BlockedError
from eal_actors.plugin import EALData
from plugins.sim.models import MAKES, MakeName
from plugins.sim.motion import Move
from plugins.sim.robot import SimRobot
from plugins.sim.world import SimBox, SimWorld
from tests.manual_clock import ManualClock
from tests.unit.plugins.sim.rig import TICK_S, Fleet, arena

CRATE = {"name": "crate", "x_m": 1.5, "y_m": 0.04, "yaw_deg": 10.0}


@pytest.mark.parametrize("x_m", [2.5, 2.503])
@pytest.mark.parametrize("model", ["evbot2", "evbot3", "roomba"])
def test_a_wall_holds_a_robot_and_the_motion_says_so(model: str, x_m: float) -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (x_m, 0, 0), model=model)
    wall_m = 3.0 - robot.plugin.robot.make.radius_m
    motion = robot.base.send_cmd("f3")
    deepest_m, statuses = 0.0, set()
    with suppress(BlockedError):
        for _ in motion:
            fleet.clock.advance(TICK_S)
            deepest_m = max(deepest_m, robot.pose[0] - wall_m)
            statuses.add(robot.base.get_status())
        pytest.fail("it answered as if it had come there")
    assert statuses == {0, 1, 2}
    assert deepest_m < 0.002
    end_m = robot.pose[0]
    assert robot.pose == pytest.approx([wall_m, 0, 0], abs=0.001)
    robot.do("b1")
    assert robot.pose == pytest.approx([end_m - 1, 0, 0], abs=1e-6)


@pytest.mark.parametrize("model", ["evbot2", "evbot3", "roomba"])
def test_a_thin_wall_holds_robots_at_full_speed_at_the_lowest_rate(model: MakeName) -> None:
    wall = {"kind": "wall", "start_m": (0, -2.5), "end_m": (0, 2.5), "thickness_m": 0.001}
    clock, make = ManualClock(), MAKES[model]
    world = SimWorld(clock, 0, arena(6.0, 6.0, physics={"rate_hz": 5}, obstacles=[wall]))
    starts = [(-2.0 + 0.03 * number, -2.0 + number) for number in range(5)]
    robots = [world.join(str(start), make, noise=False, start=(*start, 0.0)) for start in starts]
    with world.lock:
        for robot in robots:
            world.drive(robot, make.max_speed_m_s, make.max_speed_m_s)
        clock.advance(10.0)
        world.catch_up()
    assert max(robot.pose[0] for robot in robots) < 0.002 - make.radius_m


@pytest.mark.parametrize("model", ["evbot2", "evbot3", "roomba"])
def test_a_goal_that_touches_a_wall_is_refused_with_what_is_there(model: str) -> None:
    robot = Fleet().add("r1", (1.5, 0, 0), model=model)
    robot.resource("Pose")
    with pytest.raises(BlockedError, match=r"for 5 s it has not come nearer: something is 0\.05 m ahead"):
        robot.fleet.run(robot.base.send_cmd("goto", EALData.of([3.0 - robot.plugin.robot.make.radius_m, 0.0])))


def test_a_standing_robot_is_not_pushed() -> None:
    fleet = Fleet()
    mover, still = fleet.add("a", (0, 0, 0)), fleet.add("b", (0.6, 0, 0))
    with pytest.raises(BlockedError):
        mover.do("f1")
    assert still.pose == [0.6, 0, 0]
    assert mover.pose[0] == pytest.approx(0.6 - 0.34, abs=0.002)


def depth_m(box: SimBox, robot: SimRobot) -> float:
    """Return how far a robot is in a box."""
    (box_x, box_y, yaw_rad), (x_m, y_m, _) = box.pose, robot.pose
    ahead_m = math.cos(yaw_rad) * (x_m - box_x) + math.sin(yaw_rad) * (y_m - box_y)
    aside_m = math.cos(yaw_rad) * (y_m - box_y) - math.sin(yaw_rad) * (x_m - box_x)
    half_x, half_y = box.model.size_m[0] / 2, box.model.size_m[1] / 2
    return robot.make.radius_m - math.hypot(max(0.0, abs(ahead_m) - half_x), max(0.0, abs(aside_m) - half_y))


@pytest.mark.parametrize("yaw_deg", [0, 35, 70])
@pytest.mark.parametrize("x_m", [2.0, 2.0037, 2.0081])
@pytest.mark.parametrize("model", MAKES)
def test_at_full_speed_a_robot_sinks_into_a_wall_by_less_than_2_mm(model: MakeName, x_m: float, yaw_deg: float) -> None:
    clock = ManualClock()
    world = SimWorld(clock, 1, arena())
    make = MAKES[model]
    robot = world.join("r1", make, noise=True, start=(x_m, 0.0, math.radians(yaw_deg)))
    with world.lock:
        world.catch_up()
        world.drive(robot, make.max_speed_m_s, make.max_speed_m_s)
    deepest_m, blocked = -1.0, False
    for _ in range(300):
        clock.advance(TICK_S)
        with world.lock:
            world.catch_up()
            robot_x_m, robot_y_m, _ = robot.pose
            blocked |= robot.is_blocked
        deepest_m = max(deepest_m, robot_x_m + make.radius_m - 3.0, robot_y_m + make.radius_m - 2.0)
    assert -0.0001 < deepest_m < 0.002
    assert blocked


@pytest.mark.parametrize("model", MAKES)
def test_a_box_between_a_robot_and_a_wall_is_sunk_into_by_less_than_2_mm(model: MakeName) -> None:
    clock = ManualClock()
    world = SimWorld(clock, 1, arena(boxes=({**CRATE, "yaw_deg": 0.0},)))
    make = MAKES[model]
    robot = world.join("r1", make, noise=False, start=(0.5, 0.0, 0.0))
    (crate,) = world.boxes
    with world.lock:
        world.catch_up()
        world.drive(robot, make.max_speed_m_s, make.max_speed_m_s)
    deepest_m = into_wall_m = -1.0
    for _ in range(300):
        clock.advance(TICK_S)
        with world.lock:
            world.catch_up()
            x_m, _, yaw_rad = crate.pose
            deepest_m = max(deepest_m, depth_m(crate, robot))
        into_wall_m = max(into_wall_m, x_m + 0.15 * (abs(math.cos(yaw_rad)) + abs(math.sin(yaw_rad))) - 3.0)
    assert 0 < deepest_m < 0.002
    assert -0.0001 < into_wall_m < 0.002


@pytest.mark.parametrize("model", MAKES)
def test_a_box_is_pushed_and_comes_to_rest(model: MakeName) -> None:
    clock = ManualClock()
    world = SimWorld(clock, 1, arena(boxes=(CRATE,)))
    make = MAKES[model]
    robot = world.join("r1", make, noise=False, start=(0.0, 0.0, 0.0))
    (crate,) = world.boxes
    with world.lock:
        world.catch_up()
        before = crate.pose
        world.start(robot, Move.straight(make, 1.5, make.max_speed_m_s, world.tick_s))
    clock.advance(20.0)
    with world.lock:
        world.catch_up()
        x_m, y_m, _ = after = crate.pose
        assert not crate.is_moving
        assert robot.motion is None
        assert depth_m(crate, robot) < 0.002
    assert before == pytest.approx((1.5, 0.04, math.radians(10)))
    assert 1.6 < x_m < 1.9
    assert abs(y_m) < 0.15
    clock.advance(20.0)
    with world.lock:
        world.catch_up()
        assert crate.pose == after


def test_a_box_slides_on_when_its_robot_stops_at_once_and_the_world_ticks_for_it() -> None:
    clock = ManualClock()
    world = SimWorld(clock, 1, arena(boxes=({**CRATE, "friction": 0.05},)))
    robot = world.join("r1", MAKES["evbot3"], noise=False, start=(0.5, 0.04, 0.0))
    (crate,) = world.boxes
    with world.lock:
        world.catch_up()
        world.drive(robot, 0.6, 0.6)
    clock.advance(2.0)
    with world.lock:
        world.catch_up()
        world.stop(robot)
        robot_pose, at_stop = robot.pose, crate.pose
        assert crate.is_moving
    clock.advance(2.0)
    with world.lock:
        world.catch_up()
        slid_m = math.dist(crate.pose[:2], at_stop[:2])
        assert robot.pose == robot_pose
        assert not crate.is_moving
    assert slid_m == pytest.approx(0.6**2 / (2 * 0.05 * 9.81), rel=0.1)  # v squared over 2 mu g


def test_robots_that_drive_into_each_other_hold_each_other() -> None:
    clock = ManualClock()
    world = SimWorld(clock, 1, arena())
    make = MAKES["roomba"]
    one = world.join("one", make, noise=False, start=(-1.0, 0.0, 0.0))
    other = world.join("other", make, noise=False, start=(1.0, 0.0, math.pi))
    with world.lock:
        world.catch_up()
        for robot in (one, other):
            world.drive(robot, 0.5, 0.5)
    nearest_m = math.inf
    for _ in range(200):
        clock.advance(TICK_S)
        with world.lock:
            world.catch_up()
            nearest_m = min(nearest_m, math.dist(one.pose[:2], other.pose[:2]))
    assert 2 * make.radius_m - 0.004 < nearest_m < 2 * make.radius_m
    with world.lock:
        world.catch_up()
        assert one.is_blocked
        assert other.is_blocked


def test_contacts_name_both_and_count_once() -> None:
    clock = ManualClock()
    world = SimWorld(clock, 1, arena())
    make = MAKES["evbot2"]
    one = world.join("one", make, noise=False, start=(0.0, 0.0, 0.0))
    world.join("still", make, noise=False, start=(1.0, 0.0, 0.0))
    away = world.join("away", make, noise=False, start=(0.0, 1.0, math.pi / 2))
    with world.lock:
        world.catch_up()
        world.drive(one, 0.3, 0.3)
        world.drive(away, 0.3, 0.3)
    touched_s: list[float] = []
    for _ in range(500):
        clock.advance(TICK_S)
        with world.lock:
            world.catch_up()
            if 1.0 - one.pose[0] < 2 * make.radius_m + 0.001:
                touched_s.append(clock.now())
    pairs = sorted((contact.robot, contact.other) for contact in world.contacts)
    assert pairs == [("away", "the north wall"), ("one", "still")]
    (met,) = [contact for contact in world.contacts if contact.robot == "one"]
    assert met.time_s == pytest.approx(touched_s[0], abs=2 * TICK_S)


def test_robots_that_are_not_solid_neither_touch_nor_sense_each_other() -> None:
    fleet = Fleet()
    fleet.services.solid_robots = False
    sensors = {"lidar": {"noise_m": 0.0}, "depth_camera": {"noise_m": 0.0}}
    mover = fleet.add("a", (0, 0, 0), **sensors)
    fleet.add("b", (0.6, 0, 0))
    wall_m = 3.0
    assert mover.resource("Range").get_value().value[0] == pytest.approx(wall_m)
    assert mover.resource("Lidar").get_value().value[180] == pytest.approx(wall_m)
    assert mover.resource("DepthCamera").get_value().value[120, 160] == pytest.approx(wall_m, abs=0.01)
    mover.do("f1")
    assert mover.pose[0] == pytest.approx(1.0, abs=0.05)
