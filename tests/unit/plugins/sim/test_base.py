"""Base drives a simulated robot as its commands say."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from eal_actors.kernel.errors import ArgumentError
from eal_actors.plugin import EALData
from plugins.sim.resources import Base
from tests.unit.plugins.sim.rig import TICK_S, Fleet


@pytest.mark.parametrize("model", ["evbot2", "evbot3", "roomba"])
@pytest.mark.parametrize(
    ("commands", "pose"),
    [
        (["g"], [0.5, 0, 0]),
        (["b"], [-0.5, 0, 0]),
        (["r"], [0, 0, -math.pi / 2]),
        (["l"], [0, 0, math.pi / 2]),
        (["r45", "f0.25"], [0.25 / math.sqrt(2), -0.25 / math.sqrt(2), -math.pi / 4]),
        (["l12.5", "b1.25"], [-1.25 * math.cos(math.pi / 14.4), -1.25 * math.sin(math.pi / 14.4), math.pi / 14.4]),
        (["r0", "f0"], [0, 0, 0]),
        (["l360"], [0, 0, 0]),
        (["g", "r", "g", "r", "g", "r", "g", "r", "s", "l", "b", "l", "b", "l", "b", "l", "b", "s"], [0, 0, 0]),
    ],
)
def test_without_noise_commands_are_exact(model: str, commands: list[str], pose: list[float]) -> None:
    robot = Fleet().add("r1", (0, 0, 0), model=model)
    for text in commands:
        if text == "s":
            assert robot.base.send_cmd("s") == 1
        else:
            robot.do(text)
    assert robot.pose == pytest.approx(pose, abs=1e-9)
    assert robot.base.get_status() == 0


def test_yaw_is_wrapped_and_the_pose_says_frame_and_time() -> None:
    robot = Fleet().add("r1", (0, 0, 180))
    data = robot.pose_sensor.get_value()
    assert (data.value.dtype, data.value.shape, data.frame_id, data.stamp_s) == (np.float64, (3,), "world", 0)
    assert data.value[2] == math.pi
    robot.do("l90")
    data = robot.pose_sensor.get_value()
    assert data.value[2] == pytest.approx(-math.pi / 2)
    assert data.stamp_s == pytest.approx(robot.fleet.clock.now(), abs=TICK_S)


@pytest.mark.parametrize("stop", [Base.halt, lambda base: base.send_cmd("s")], ids=["halt", "s"])
def test_a_stop_in_the_middle_holds_at_once(stop: Callable[[Base], Any]) -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (0, 0, 0))
    motion = robot.base.send_cmd("f2")
    next(motion)
    fleet.clock.advance(2.0)
    assert robot.base.get_status() == 1
    stop(robot.base)
    at = robot.pose
    assert 0.3 < at[0] < 0.6
    assert robot.base.get_status() == 0
    fleet.clock.advance(2.0)
    assert robot.pose == at
    motion.close()


def test_closing_an_activity_stops_only_its_own_motion() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (0, 0, 0))
    first, second = robot.base.send_cmd("f2"), robot.base.send_cmd("l90")
    next(first)
    fleet.clock.advance(1.0)
    next(second)
    first.close()
    assert robot.base.get_status() == 1
    second.close()
    assert robot.base.get_status() == 0


def test_configuration_changes_speeds_and_step() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (0, 0, 0))
    robot.base.set_config("speed_m_s", EALData.of(0.1))
    robot.base.set_config("turn_rate_deg_s", EALData.of(30))
    robot.base.set_config("step_m", EALData.of(1))
    assert [robot.base.get_config(key) for key in ("speed_m_s", "turn_rate_deg_s", "step_m")] == [0.1, 30.0, 1.0]
    robot.do("g")
    assert robot.pose[0] == pytest.approx(1.0)
    drive_s = fleet.clock.now()
    assert 10 < drive_s < 10.5
    robot.do("l90")
    assert 3 < fleet.clock.now() - drive_s < 3.5
    with pytest.raises(ArgumentError, match=r"0\.01\.\.0\.5 m/s"):
        robot.base.set_config("speed_m_s", EALData.of(0.55))
    with pytest.raises(ArgumentError):
        robot.base.send_cmd("l3601")


def test_two_robots_move_at_once_and_one_more_stands() -> None:
    fleet = Fleet()
    one, two, still = fleet.add("a", (-1, 0, 0)), fleet.add("b", (1, 0, 90)), fleet.add("c", (0, 1.5, 0))
    assert fleet.run(one.base.send_cmd("g"), two.base.send_cmd("g")) == [1, 1]
    assert one.pose == pytest.approx([-0.5, 0, 0], abs=1e-9)
    assert two.pose == pytest.approx([1, 0.5, math.pi / 2], abs=1e-9)
    assert still.pose == [0, 1.5, 0]


@pytest.mark.parametrize("model", ["evbot2", "evbot3", "roomba"])
def test_its_information_names_the_makes_own_reach(model: str) -> None:
    robot = Fleet().add("r1", (0, 0, 0), model=model)
    info, make = robot.base.info(), robot.plugin.robot.make
    assert info.config("speed_m_s").value.maximum == make.max_speed_m_s
    assert info.config("turn_rate_deg_s").value.maximum == make.max_turn_rate_deg_s
    assert info.config("step_m").value.maximum == 10


def test_a_twist_ends_by_itself_and_a_newer_one_takes_over_without_a_stop() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (-2, 0, 0))
    for _ in range(10):
        twist = robot.base.set_value(EALData.of([0.3, 0.0]))
        next(twist)
        fleet.clock.advance(0.2)
        twist.close()
    assert robot.plugin.robot.wheel_speeds_m_s == (0.3, 0.3)
    assert robot.base.get_status() == 1
    fleet.clock.advance(0.29)
    assert robot.base.get_status() == 1
    fleet.clock.advance(0.4)
    assert robot.base.get_status() == 0
    assert robot.pose[0] == pytest.approx(-2 + 0.3 * 2.3, abs=1e-9)  # as long to slow down as to speed up


def test_the_activity_of_a_twist_lasts_until_the_robot_rests() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (0, 0, 0))
    robot.base.set_config("twist_timeout_s", EALData.of(2.0))
    assert fleet.run(robot.base.set_value(EALData.of([0.0, 1.0]))) == [1]
    assert robot.base.get_status() == 0
    assert robot.pose == pytest.approx([0, 0, 2.0], abs=1e-9)
    assert 2.1 < fleet.clock.now() < 2.25


def test_a_twist_of_zero_slows_down_and_a_halt_stops_at_once() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (0, 0, 0))
    next(robot.base.set_value(EALData.of([0.3, 0.0])))
    fleet.clock.advance(0.45)
    assert fleet.run(robot.base.set_value(EALData.of([0.0, 0.0]))) == [1]
    assert robot.pose[0] == pytest.approx(0.3 * 0.45 - 0.006, abs=0.01)
    next(robot.base.set_value(EALData.of([0.3, 0.0])))
    fleet.clock.advance(0.45)
    before = robot.pose
    robot.base.halt()
    fleet.clock.advance(1.0)
    assert robot.pose == before


@pytest.mark.parametrize("twist", [[0.51, 0.0], [0.0, 3.2], [math.nan, 0.0], [0.0, -math.inf]])
def test_a_twist_that_the_make_does_not_reach_is_refused(twist: list[float]) -> None:
    robot = Fleet().add("r1", (0, 0, 0))
    with pytest.raises(ArgumentError, match="the roomba reaches"):
        robot.base.set_value(EALData.of(twist))
    assert robot.base.get_status() == 0


def test_a_twist_over_the_wheels_reach_keeps_its_curve() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (0, 0, 0))
    next(robot.base.set_value(EALData.of([0.5, 2.0])))
    fleet.clock.advance(0.49)
    robot.base.get_status()
    left_m_s, right_m_s = robot.plugin.robot.wheel_speeds_m_s
    assert right_m_s < 0.5
    next(robot.base.set_value(EALData.of([0.5, 2.0])))
    fleet.clock.advance(0.49)
    robot.base.get_status()
    left_m_s, right_m_s = robot.plugin.robot.wheel_speeds_m_s
    assert right_m_s == pytest.approx(0.5)
    assert (right_m_s - left_m_s) / 0.258 / ((right_m_s + left_m_s) / 2) == pytest.approx(2.0 / 0.5)
