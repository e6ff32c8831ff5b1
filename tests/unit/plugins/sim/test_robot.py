"""Paths of simulated robots against closed forms."""

from __future__ import annotations

import math

import pytest

from eal_actors.kernel.errors import ArgumentError, BlockedError
from eal_actors.plugin import MOST_SLIP_M, EALData
from plugins.sim.arena import Pose2D
from plugins.sim.models import MAKES, MakeName
from plugins.sim.motion import Move
from plugins.sim.robot import SimRobot
from plugins.sim.world import SimWorld
from tests.manual_clock import ManualClock
from tests.unit.plugins.sim.rig import TICK_S, Fleet, arena

ROOM = arena(60.0, 60.0)


def stage(model: MakeName) -> tuple[ManualClock, SimWorld, SimRobot]:
    clock = ManualClock()
    world = SimWorld(clock, 1, ROOM)
    return clock, world, world.join("r1", MAKES[model], noise=False, start=(0.0, 0.0, 0.0))


def pose_after(clock: ManualClock, world: SimWorld, robot: SimRobot, duration_s: float) -> Pose2D:
    clock.advance(duration_s)
    with world.lock:
        world.catch_up()
        return robot.pose


@pytest.mark.parametrize("model", MAKES)
def test_a_straight_follows_its_trapezoid(model: MakeName) -> None:
    clock, world, robot = stage(model)
    make = robot.make
    ramp_s, most_m_s, a = make.max_speed_m_s / make.acceleration_m_s2, make.max_speed_m_s, make.acceleration_m_s2
    with world.lock:
        world.catch_up()
        world.start(robot, Move.straight(make, 3.0, most_m_s, TICK_S))
    total_s = 3.0 / most_m_s + ramp_s
    for number in range(1, 200):
        x_m, y_m, yaw_rad = pose_after(clock, world, robot, 0.06)
        time_s = min(number * 0.06, total_s)
        up_s, down_s = min(time_s, ramp_s), max(0.0, time_s - (total_s - ramp_s))
        expected_m = a * up_s**2 / 2 + most_m_s * max(0.0, time_s - ramp_s) - a * down_s**2 / 2
        assert x_m == pytest.approx(expected_m, rel=1e-3, abs=1e-9)
        assert (y_m, yaw_rad) == (0, 0)


@pytest.mark.parametrize("model", MAKES)
@pytest.mark.parametrize("degrees", [90, -1080])
def test_a_spin_follows_its_trapezoid_and_stays_in_place(model: MakeName, degrees: float) -> None:
    clock, world, robot = stage(model)
    make = robot.make
    rate_rad_s = math.radians(make.max_turn_rate_deg_s)
    a = make.acceleration_m_s2 / (make.track_m / 2)
    with world.lock:
        world.catch_up()
        world.start(robot, Move.turn(make, math.radians(degrees), rate_rad_s, TICK_S))
    ramp_s = rate_rad_s / a
    half_rad = math.radians(abs(degrees)) / 2
    cruise_s = max(0.0, (half_rad - a * ramp_s**2 / 2) / rate_rad_s)
    half_s = ramp_s + cruise_s if cruise_s else math.sqrt(2 * half_rad / a)
    ticks = round(half_s / TICK_S)
    x_m, y_m, yaw_rad = pose_after(clock, world, robot, ticks * TICK_S)
    off_rad = (ticks * TICK_S - half_s) * rate_rad_s  # half of it is done at a time between ticks
    assert yaw_rad == pytest.approx(math.copysign(half_rad + off_rad, degrees), rel=1e-2 if degrees == 90 else 1e-3)
    assert (x_m, y_m) == (0, 0)
    assert pose_after(clock, world, robot, 60.0)[2] == pytest.approx(math.radians(degrees), abs=1e-9)


@pytest.mark.parametrize("model", MAKES)
@pytest.mark.parametrize("bend", [0.9, -0.4, 0.0])
def test_an_arc_is_a_part_of_a_circle(model: MakeName, bend: float) -> None:
    """Both wheels in proportion, so that also while they speed up the robot stays on one circle."""
    clock, world, robot = stage(model)
    make = robot.make
    right_m_s, left_m_s = make.max_speed_m_s, make.max_speed_m_s * bend
    with world.lock:
        world.catch_up()
        world.drive(robot, left_m_s, right_m_s)
    pose_after(clock, world, robot, 2.0)
    with world.lock:
        world.catch_up()
        assert robot.wheel_speeds_m_s == pytest.approx((left_m_s, right_m_s))
        start_x_m, start_y_m, start_yaw_rad = robot.pose
    radius_m = make.track_m / 2 * (right_m_s + left_m_s) / (right_m_s - left_m_s)
    rate_rad_s = (right_m_s - left_m_s) / make.track_m
    middle_x_m = start_x_m - radius_m * math.sin(start_yaw_rad)
    middle_y_m = start_y_m + radius_m * math.cos(start_yaw_rad)
    for number in range(1, 50):
        x_m, y_m, yaw_rad = pose_after(clock, world, robot, 0.5)
        expected_rad = start_yaw_rad + rate_rad_s * 0.5 * number
        assert yaw_rad == pytest.approx(expected_rad, rel=1e-9)
        assert x_m == pytest.approx(middle_x_m + radius_m * math.sin(expected_rad), abs=1e-9)
        assert y_m == pytest.approx(middle_y_m - radius_m * math.cos(expected_rad), abs=1e-9)


def test_a_curve_with_accelerations_is_within_a_thousandth_of_fine_integration() -> None:
    clock, world, robot = stage("roomba")
    make = robot.make
    with world.lock:
        world.catch_up()
        world.drive(robot, 0.2, 0.5, hold_s=2.0)
    end = pose_after(clock, world, robot, 4.0)
    x_m = y_m = yaw_rad = 0.0
    step_s = 1e-4
    for number in range(40000):
        time_s = (number + 0.5) * step_s
        left, right = (
            min(target, make.acceleration_m_s2 * time_s, max(0.0, target - make.acceleration_m_s2 * (time_s - 2.0)))
            for target in (0.2, 0.5)
        )
        half_rad = (right - left) / make.track_m * step_s / 2
        x_m += (left + right) / 2 * step_s * math.cos(yaw_rad + half_rad)
        y_m += (left + right) / 2 * step_s * math.sin(yaw_rad + half_rad)
        yaw_rad += 2 * half_rad
    assert math.dist(end[:2], (x_m, y_m)) < 1e-3 * 0.35 * 2
    assert end[2] == pytest.approx(yaw_rad, rel=1e-3)


def test_encoders_count_what_was_commanded_also_of_a_robot_that_is_stuck() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (2.5, 0, 0), model="evbot2")
    with pytest.raises(BlockedError):
        robot.do("f1")
    make = robot.plugin.robot.make
    until_held_m = 0.5 - make.radius_m
    with robot.plugin.world.lock:
        robot.plugin.world.catch_up()
        held_m = robot.plugin.robot.travel_m
    assert held_m == pytest.approx([until_held_m + MOST_SLIP_M] * 2, abs=0.015)
    robot.do("l90")
    turn_m = make.track_m / 2 * math.pi / 2
    with robot.plugin.world.lock:
        robot.plugin.world.catch_up()
        travel_m = robot.plugin.robot.travel_m
    assert travel_m == pytest.approx((held_m[0] - turn_m, held_m[1] + turn_m), abs=make.encoder_step_m)
    assert [travel / make.encoder_step_m % 1 for travel in travel_m] == pytest.approx([0, 0], abs=1e-6)


def test_odometry_believes_the_encoders() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (-1, 0, 90), model="evbot2", noise=True)
    odometry = robot.resource("Odometry")
    robot.do("f1", "l90", "f0.5")
    data = odometry.get_value()
    assert data.frame_id == "r1/odom"
    assert data.value == pytest.approx([1, 0.5, math.pi / 2], abs=0.005)
    assert math.dist(robot.pose[:2], (-1.5, 1.0)) > 0.005  # while it truly is elsewhere
    assert odometry.send_req("travel").value.sum() == pytest.approx(3.0, abs=0.002)
    odometry.set_value(EALData.of([5.0, 5.0, math.pi]))
    robot.do("f0.5")
    assert odometry.get_value().value[:2] == pytest.approx([4.5, 5.0], abs=0.002)
    with pytest.raises(ArgumentError, match="finite"):
        odometry.set_value(EALData.of([math.nan, 0.0, 0.0]))


def test_odometry_does_not_depend_on_who_looks() -> None:
    def believed(look_s: float) -> list[float]:
        fleet = Fleet()
        robot = fleet.add("r1", (0, 0, 0), model="evbot3", noise=True)
        odometry = robot.resource("Odometry")
        with robot.plugin.world.lock:
            robot.plugin.world.catch_up()
            robot.plugin.world.drive(robot.plugin.robot, 0.2, 0.3, hold_s=3.0)
        for _ in range(round(6.0 / look_s)):
            fleet.clock.advance(look_s)
            odometry.get_value()
        values: list[float] = odometry.get_value().value.tolist()
        return values

    assert believed(0.01) == believed(3.0)


def test_the_turret_turns_by_itself() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (0, 0, 0), model="evbot3")
    turret = robot.resource("Turret")
    assert fleet.run(turret.send_cmd("l90")) == [1]
    assert turret.get_value().value == pytest.approx(math.pi / 2)
    assert fleet.clock.now() == pytest.approx(90 / 90 + 90 / 360, abs=TICK_S)
    robot.do("l90")
    assert turret.get_value().value == pytest.approx(math.pi / 2)
    assert fleet.run(turret.send_cmd("t-170")) == [1]  # the shorter way, through the back
    assert turret.get_value().value == pytest.approx(math.radians(-170))
    assert robot.plugin.robot.turret_yaw_rad == pytest.approx(math.radians(190))
    turn = turret.send_cmd("r180")
    next(turn)
    fleet.clock.advance(0.5)
    assert turret.get_status() == 1
    assert turret.send_cmd("s") == 1
    turn.close()
    stopped = turret.get_value().value
    fleet.clock.advance(1.0)
    assert (turret.get_value().value, turret.get_status()) == (stopped, 0)
