"""A simulated base that knows its wheels: its motions come out true, and its odometry believes what is."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from eal_actors.kernel.errors import ArgumentError, UnavailableError
from eal_actors.plugin import EALData
from plugins.sim.models import MAKES, MakeName
from tests.unit.plugins.sim.rig import Fleet, Robot, arena


def robot_of(model: MakeName, *, calibrated: bool = True) -> Robot:
    """Return a robot whose wheels err, but not by chance; its base knows them, or believes them to be nominal."""
    raw = MAKES[model].raw_errors
    known = {"track_factor": raw.track_factor, "wheel_ratio": raw.k_right / raw.k_left} if calibrated else {}
    robot = Fleet(arena(9, 9)).add("r", (0, 0, 0), model=model, noise=True, calibrated=False, calibration=known)
    wheels = robot.plugin.robot._wheels
    wheels._turn_noise_rad, wheels._errors = 0.0, replace(raw, scatter_m=0.0)
    return robot


@pytest.mark.parametrize("model", MAKES)
def test_distances_and_angles_come_out_true(model: MakeName) -> None:
    robot = robot_of(model)
    odometry = robot.resource("Odometry")
    robot.do("f2")
    assert robot.pose == pytest.approx([2.0, 0.0, 0.0], abs=1e-9)
    robot.do("l90")
    assert robot.pose == pytest.approx([2.0, 0.0, math.pi / 2], abs=2e-3)
    robot.do("b1", "r45")
    believed = odometry.get_value().value.tolist()
    assert believed == pytest.approx(robot.pose, abs=5e-3)
    assert abs(robot_of(model, calibrated=False).pose[2]) == 0.0


@pytest.mark.parametrize("model", MAKES)
def test_a_twist_comes_out_true(model: MakeName) -> None:
    robot = robot_of(model)
    robot.fleet.run(robot.base.set_value(EALData.of([0.2, 0.0])))
    x_m, y_m, yaw_rad = robot.pose
    assert x_m > 0.05
    assert yaw_rad == pytest.approx(0.0, abs=1e-9)
    assert y_m == pytest.approx(0.0, abs=2e-4)  # while speeding up, the faster wheel takes longer


def test_a_base_is_calibrated_while_it_lives() -> None:
    robot = robot_of("evbot2", calibrated=False)
    robot.do("l90")
    assert robot.pose[2] == pytest.approx(math.pi / 2 / 1.2, abs=2e-3)
    robot.base.set_config("track_factor", EALData.of(1.2))
    robot.do("l90")
    assert robot.pose[2] == pytest.approx(math.pi / 2 / 1.2 + math.pi / 2, abs=4e-3)
    assert robot.base.get_config("wheelbase_m") == MAKES["evbot2"].track_m
    with pytest.raises(ArgumentError, match="wheel_ratio"):
        robot.base.set_config("wheel_ratio", EALData.of(1.3))


def test_a_robot_is_carried_elsewhere_but_not_into_another_or_while_it_drives() -> None:
    fleet = Fleet(arena())
    robot, other = fleet.add("r", (0, 0, 0)), fleet.add("other", (1, 0, 0))
    robot.pose_sensor.set_value(EALData.of([-1.0, 0.5, 1.0]))
    assert robot.pose == pytest.approx([-1.0, 0.5, 1.0])
    robot.do("f0.2")
    assert robot.pose[:2] == pytest.approx([-1 + 0.2 * math.cos(1), 0.5 + 0.2 * math.sin(1)])
    for place in ([0.9, 0.0, 0.0], [50.0, 0.0, 0.0], [math.nan, 0.0, 0.0]):
        with pytest.raises(ArgumentError):
            robot.pose_sensor.set_value(EALData.of(place))
    driving = other.base.send_cmd("f1")
    next(driving)
    with pytest.raises(UnavailableError, match="'other' is driven: halt it"):
        other.pose_sensor.set_value(EALData.of([0.0, 0.0, 0.0]))
