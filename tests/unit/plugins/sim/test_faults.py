"""Faults on purpose: what each does to a robot, and when the plan makes it happen."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from eal_actors.kernel.errors import ArgumentError, ResourceFaultError, UnavailableError
from eal_actors.plugin import EALData, ResourceType
from plugins.sim import plugin as sim
from plugins.sim import resources
from plugins.sim.faults import HEALTHY, SENSORS, FaultPlan, FaultSet, PlannedFault
from tests.unit.plugins.sim.rig import TICK_S, Fleet, Robot

TRACK_M = 0.258
"""Of the roomba."""


def inject(robot: Robot, **faults: Any) -> None:
    """Set faults by calls, each call on a resource made anew: it keeps nothing that the robot does not."""
    for key, value in faults.items():
        robot.resource("Faults").set_config(key, EALData.of(value))


def clear(robot: Robot) -> None:
    assert robot.resource("Faults").send_cmd("clear") is None


def present(robot: Robot) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(robot.resource("Faults").get_value().value)
    return found


def travel_m(robot: Robot) -> list[float]:
    counted: list[float] = robot.resource("Odometry").send_req("travel").value.tolist()
    return counted


# The core.


def test_every_sensor_but_the_ground_truth_can_freeze() -> None:
    made = [getattr(resources, name) for name in resources.__all__]
    assert {kind.__name__ for kind in made if ResourceType.SENSOR in kind.types} - {"TruePose"} == set(SENSORS)


def test_a_plan_tells_what_changes_and_when() -> None:
    planned = [
        {"at_s": 8, "until_s": 10, "frozen": ["Range"], "motor_left": 0.2},
        {"at_s": 5.0, "motor_left": 0.5},
        {"at_s": 10, "motor_left": 0.7},
    ]
    plan = FaultPlan([PlannedFault.model_validate(fault) for fault in planned])
    assert (plan.next_s, plan.take_due(4.999)) == (5.0, {})
    assert plan.take_due(5.0) == {"motor_left": 0.5}
    assert (plan.next_s, plan.take_due(8.5)) == (8.0, {"frozen": ("Range",), "motor_left": 0.2})
    assert plan.take_due(10.0) == {"frozen": (), "motor_left": 0.7}  # what begins has the last word
    assert (plan.next_s, plan.take_due(1e9)) == (math.inf, {})


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ({"motor_left": 0.5}, "at_s"),
        ({"at_s": -1, "dead": True}, "at_s"),
        ({"at_s": 1}, "names no fault"),
        ({"at_s": 1, "until_s": 1, "dead": True}, "ends at 1 s, but begins only at 1 s"),
        ({"at_s": 1, "motor_left": 1.5}, "motor_left"),
        ({"at_s": 1, "dead": 1}, "dead"),
        ({"at_s": 1, "frozen": ["TruePose"]}, "frozen"),
        ({"at_s": 1, "ded": True}, "ded"),
    ],
)
def test_a_bad_plan_is_refused(fault: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        PlannedFault.model_validate(fault)


def test_a_make_freezes_only_what_it_has() -> None:
    faults = [{"at_s": 1, "frozen": ["Range", "Cliff"]}]
    sim.Settings.model_validate({"model": "roomba", "faults": faults})
    with pytest.raises(ValidationError, match="the evbot2 has no Cliff to freeze"):
        sim.Settings.model_validate({"model": "evbot2", "faults": faults})


# The resource.


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("motor_left", 0.25),
        ("motor_right", 0),
        ("stuck_left", True),
        ("stuck_right", True),
        ("frozen", "Range,Camera"),
        ("camera_black", True),
        ("battery_empty", True),
        ("dead", True),
        ("link_delay_s", 0.5),
        ("link_loss", 0.1),
        ("link_cut", True),
    ],
)
def test_each_fault_is_set_read_back_and_cleared_by_calls(key: str, value: Any) -> None:
    robot = Fleet().add("r1")
    faults = robot.resource("Faults")
    assert {info.name for info in faults.info().configs} == set(FaultSet.model_fields)
    whole = faults.get_config(key).value
    assert (faults.get_status(), present(robot)) == (0, {})
    inject(robot, **{key: value})
    assert faults.get_config(key).value == value
    assert faults.get_status() == 1
    assert list(present(robot)) == [key]
    clear(robot)
    assert (faults.get_config(key).value, faults.get_status(), present(robot)) == (whole, 0, {})
    assert robot.plugin.robot.faults == HEALTHY


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("motor_left", 1.1, "must be double 0..1"),
        ("link_delay_s", -0.1, "must be double 0..3600 s"),
        ("dead", 1, "must be bool"),
        (
            "frozen",
            "Range, TruePose",
            "robot 'r1' has no resource 'TruePose' that can be frozen; use: Odometry, Battery, Pose",
        ),
        ("frozen", "Cliff", "has no resource 'Cliff'"),
        ("motr_left", 0.5, "did you mean 'motor_left'"),
    ],
)
def test_what_is_no_fault_is_refused_and_changes_nothing(key: str, value: Any, message: str) -> None:
    robot = Fleet().add("r1", model="evbot2")
    with pytest.raises(ArgumentError, match=message):
        inject(robot, **{key: value})
    assert present(robot) == {}


def test_names_of_sensors_may_have_spaces_and_none_thaws_them() -> None:
    robot = Fleet().add("r1")
    inject(robot, frozen=" Range , Camera,")
    assert present(robot) == {"frozen": ["Range", "Camera"]}
    inject(robot, frozen="")
    assert present(robot) == {}


def test_a_plan_is_carried_out_once_whoever_restarts() -> None:
    fleet = Fleet()
    planned = ({"at_s": 1.0, "motor_left": 0.5}, {"at_s": 2.0, "until_s": 3.5, "stuck_right": True})
    robot = fleet.add("r1", faults=planned)
    seen: list[tuple[float, dict[str, Any]]] = []
    running = robot.resource("Faults").background()
    for wait_s in running or ():
        seen.append((fleet.clock.now(), present(robot)))
        fleet.clock.advance(wait_s)
    seen.append((fleet.clock.now(), present(robot)))
    weak, both = {"motor_left": 0.5}, {"motor_left": 0.5, "stuck_right": True}
    assert seen == [(0.0, {}), (1.0, weak), (2.0, both), (3.5, weak)]
    clear(robot)
    assert fleet.add("r1", faults=planned).resource("Faults").background() is None
    assert present(robot) == {}


def test_who_connects_late_has_what_fell_due_at_once() -> None:
    fleet = Fleet()
    fleet.clock.advance(5.0)
    robot = fleet.add("r1", faults=({"at_s": 1, "motor_left": 0.5}, {"at_s": 2, "until_s": 3, "dead": True}))
    assert list(robot.resource("Faults").background() or ()) == []
    assert present(robot) == {"motor_left": 0.5}


# The wheels.


@pytest.mark.parametrize(("motor", "side"), [("motor_left", 1), ("motor_right", -1)])
def test_a_weak_motor_curves_to_its_side_and_odometry_tells_so(motor: str, side: int) -> None:
    fleet = Fleet()
    robot, healthy = fleet.add("r1", (0, 0, 0)), fleet.add("r2", (0, 1, 0))
    odometry = robot.resource("Odometry")
    inject(robot, **{motor: 0.8})
    robot.do("f1")
    weak_s = fleet.clock.now()
    assert robot.pose[2] == pytest.approx(side * 0.2 / TRACK_M)
    assert sorted(travel_m(robot)) == pytest.approx([0.8, 1.0], abs=0.001)
    assert odometry.get_value().value == pytest.approx(robot.pose, abs=0.01)
    healthy.do("f1")
    assert fleet.clock.now() - weak_s == pytest.approx(weak_s)


@pytest.mark.parametrize(("wheel", "side"), [("stuck_left", 1), ("stuck_right", -1)])
def test_a_robot_turns_about_its_stuck_wheel_and_the_motion_fails(wheel: str, side: int) -> None:
    robot = Fleet().add("r1", (0, 0, 0))
    inject(robot, **{wheel: True, wheel.replace("stuck", "motor"): 0.9})
    with pytest.raises(ResourceFaultError, match=f"the {wheel.removeprefix('stuck_')} wheel was driven"):
        robot.do("f0.05")
    x_m, y_m, yaw_rad = robot.pose
    assert yaw_rad == pytest.approx(side * 0.05 / TRACK_M)
    assert math.dist((x_m, y_m), (0, side * TRACK_M / 2)) == pytest.approx(TRACK_M / 2)
    assert sorted(travel_m(robot)) == pytest.approx([0.0, 0.05], abs=0.001)


def test_a_stuck_robot_halts_in_the_middle_of_a_long_motion() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (0, 0, 0))
    inject(robot, stuck_left=True)
    with pytest.raises(ResourceFaultError, match="the left wheel"):
        robot.do("f1")
    assert fleet.clock.now() <= 1.0
    assert robot.base.get_status() == 0


def test_a_robot_with_both_wheels_stuck_is_blocked() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (0, 0, 0))
    inject(robot, stuck_left=True, stuck_right=True)
    drive = robot.base.send_cmd("f1")
    next(drive)
    fleet.clock.advance(1.0)
    assert robot.base.get_status() == 2
    with pytest.raises(ResourceFaultError, match="the left and the right wheel"):
        fleet.run(drive)
    assert robot.pose == [0, 0, 0]
    assert robot.base.get_status() == 0


def test_a_path_without_faults_is_bit_by_bit_what_it_was() -> None:
    def path(*, before: bool) -> list[str]:
        robot = Fleet().add("r1", (0, 0, 0), noise=True)
        if before:
            inject(robot, motor_left=0.3, stuck_right=True, dead=True, link_loss=0.5)
            clear(robot)
        robot.do("f0.7", "l100", "b0.4")
        return [value.hex() for value in robot.pose]

    assert path(before=True) == path(before=False)


# Sensors.


@pytest.mark.parametrize("sensor", [name for name in SENSORS if name not in ("Odometry", "Camera")])
def test_a_frozen_sensor_keeps_its_value_and_its_stamp(sensor: str) -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (0, 0, 0), lidar={}, imu={}, depth_camera={})
    resource = robot.resource(sensor)
    before = resource.get_value()
    fleet.clock.advance(1.0)
    inject(robot, frozen=sensor)
    robot.do("r60", "f0.5")
    assert resource.get_value() == before
    inject(robot, frozen="")
    assert resource.get_value().stamp_s == pytest.approx(fleet.clock.now(), abs=TICK_S)


def test_frozen_answers_to_requests_are_kept_each_for_itself() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (0, 0, 0))
    odometry = robot.resource("Odometry")
    pose = odometry.get_value()
    inject(robot, frozen="Odometry")
    robot.do("f0.5")
    first = odometry.send_req("travel")  # nobody had asked for it before
    assert first.value == pytest.approx([0.5, 0.5], abs=0.001)
    robot.do("f0.5")
    assert odometry.send_req("travel") == first
    assert odometry.get_value() == pose
    clear(robot)
    assert odometry.get_value().value == pytest.approx([1, 0, 0], abs=0.001)


def test_the_camera_sees_black_in_pictures_of_the_same_form() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (0, 0, 0))
    camera = robot.resource("Camera")
    seen = camera.get_value()
    inject(robot, camera_black=True)
    fleet.clock.advance(1.0)
    black = camera.get_value()
    assert (black.shape, black.value.dtype, black.frame_id, black.stamp_s) == (
        seen.shape,
        seen.value.dtype,
        seen.frame_id,
        1.0,
    )
    assert seen.value.any()
    assert not black.value.any()
    clear(robot)
    assert np.array_equal(camera.get_value().value, seen.value)


# Power.


def test_an_empty_battery_stops_the_motors_until_it_is_whole_again() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (0, 0, 0))
    battery = robot.resource("Battery")
    drive = robot.base.send_cmd("f2")
    next(drive)
    fleet.clock.advance(1.0)
    full_v = battery.send_req("voltage").value
    inject(robot, battery_empty=True)
    stopped_at = robot.pose
    assert battery.get_value().value == 0
    assert battery.send_req("voltage").value < full_v
    with pytest.raises(UnavailableError, match="battery is empty"):
        fleet.run(drive)
    with pytest.raises(UnavailableError, match="battery is empty"):
        fleet.run(robot.base.send_cmd("f1"))
    assert robot.pose == stopped_at
    clear(robot)
    assert battery.get_value().value > 0.9
    robot.do("b0.1")


def test_a_motion_that_lost_its_power_for_a_while_does_not_claim_to_be_done() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (0, 0, 0))
    drive, twist = robot.base.send_cmd("f1"), robot.base.set_value(EALData.of([0.1, 0.0]))
    for motion in (drive, twist):
        next(motion)
        fleet.clock.advance(0.2)
        inject(robot, battery_empty=True)
        fleet.clock.advance(0.1)
        clear(robot)
        with pytest.raises(UnavailableError, match="had no power for a while: robot 'r1' has stopped"):
            fleet.run(motion)


def test_a_dead_robot_stands_and_is_silent_about_what_it_did() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (0, 0, 0), model="evbot3")
    turret = robot.resource("Turret")
    motions = [robot.base.send_cmd("f1"), turret.send_cmd("l90")]
    for motion in motions:
        next(motion)
    fleet.clock.advance(0.5)
    inject(robot, dead=True)
    assert robot.plugin.robot.is_dead
    x_m, yaw_rad = robot.pose[0], turret.get_value().value
    assert 0 < x_m < 0.3
    assert 0 < yaw_rad < 1
    for _ in range(3):
        fleet.clock.advance(20.0)
        assert all(next(motion) > 0 for motion in motions)
    assert (robot.pose[0], turret.get_value().value) == (x_m, yaw_rad)
    with pytest.raises(UnavailableError, match="robot 'r1' is dead"):
        robot.resource("Range").get_value()
    clear(robot)
    for motion in motions:
        with pytest.raises(UnavailableError, match="robot 'r1' was dead meanwhile"):
            next(motion)
    assert not robot.plugin.robot.is_dead
    robot.do("b0.1")


def test_link_faults_are_those_of_the_robots_link_and_spare_what_is_no_part_of_it() -> None:
    fleet = Fleet()
    robot = fleet.add("r1")
    link = fleet.services.link("r1")
    assert {"Faults", "TruePose", "sim.Faults", "sim.TruePose"} <= link.spared
    inject(robot, link_delay_s=0.2, link_loss=0.1, link_cut=True)
    assert (link.delay_s, link.loss, link.is_cut) == (0.2, 0.1, True)
    inject(robot, dead=True, link_cut=False)
    assert link.is_cut
    clear(robot)
    assert not link.is_faulty
