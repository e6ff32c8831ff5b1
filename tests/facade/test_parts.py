"""Typed handles of robots' parts, with futures and with values, and what they encode to."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, assert_type

import numpy as np
import pytest
from numpy.typing import NDArray

from eal_actors import EAL, Fleet, Future, RobotHandle, connect
from eal_actors.actors.call import Call, watch_calls
from eal_actors.device.localization.pose_estimate import PoseEstimate
from eal_actors.kernel.errors import ArgumentError, ResourceNotFoundError, UnavailableError
from eal_actors.testing import Simulation


@pytest.fixture
def simulation() -> Iterator[Simulation]:
    with Simulation({"a": "evbot3", "b": "roomba"}) as simulation:
        yield simulation


def calls_of(action: Callable[[], object]) -> list[tuple[Any, ...]]:
    """Return the calls that an action makes: resource, method, and arguments as plain values."""
    found: list[tuple[Any, ...]] = []

    def note(call: Call[Any]) -> None:
        plain = (getattr(argument, "value", argument) for argument in call.arguments)
        found.append((call.cell.name, call.method, *(value for value in plain if value is not None)))

    stop = watch_calls(note)
    try:
        action()
    finally:
        stop()
    return found


ENCODINGS: list[tuple[Callable[[RobotHandle], object], tuple[Any, ...]]] = [
    (lambda robot: robot.base.drive(0.3), ("Base", "send_cmd", "f0.3")),
    (lambda robot: robot.base.drive(-2), ("Base", "send_cmd", "b2")),
    (lambda robot: robot.base.drive(1e-6), ("Base", "send_cmd", "f0.000001")),
    (lambda robot: robot.base.turn(90), ("Base", "send_cmd", "l90")),
    (lambda robot: robot.base.turn(-22.5), ("Base", "send_cmd", "r22.5")),
    (lambda robot: robot.base.go_to(1, 2), ("Base", "send_cmd", "goto", [1.0, 2.0])),
    (lambda robot: robot.base.go_to(1, 2, 180), ("Base", "send_cmd", "goto", [1.0, 2.0, math.pi])),
    (lambda robot: robot.base.go_to(1, 2, 900), ("Base", "send_cmd", "goto", [1.0, 2.0, math.pi])),
    (lambda robot: robot.base.follow([(0, 1), (2, 3)]), ("Base", "send_cmd", "follow", [0.0, 1.0, 2.0, 3.0])),
    (lambda robot: robot.base.set_velocity(0.1, 90), ("Base", "set_value", [0.1, math.pi / 2])),
    (lambda robot: robot.base.stop(), ("Base", "halt")),
    (lambda robot: robot.turret.turn_to(-45), ("Turret", "send_cmd", "t-45")),
    (lambda robot: robot.turret.turn(-45), ("Turret", "send_cmd", "r45")),
    (lambda robot: robot.pose.get(), ("Pose", "send_req", "estimate")),
    (lambda robot: robot.pose.set(1, 2, 180), ("Pose", "set_value", [1.0, 2.0, math.pi])),
    (lambda robot: robot.pose.set(1, 2, -900), ("Pose", "set_value", [1.0, 2.0, -math.pi])),
    (lambda robot: robot.camera.frame(), ("Camera", "get_value")),
    (lambda robot: robot.ranges.get(), ("Range", "get_value")),
]


def test_each_call_encodes_to_the_thesiss(simulation: Simulation) -> None:
    robot = simulation["a"]
    for act, call in ENCODINGS:
        assert calls_of(lambda act=act: act(robot)) == [call]  # type: ignore[misc]
    robot.halt().get()


def test_the_values_have_their_types(simulation: Simulation) -> None:
    robot = simulation["a"]
    estimate = assert_type(robot.pose.get(), Future[PoseEstimate]).get()
    assert isinstance(estimate, PoseEstimate)
    assert estimate.frame_id == "map"
    frame = assert_type(robot.camera.frame().get(), NDArray[np.uint8])
    assert frame.shape[2] == 3
    assert isinstance(assert_type(robot.battery.get().get(), float), float)
    assert assert_type(robot.bump.get().get(), bool) is False
    assert assert_type(robot.ranges.get().get(), NDArray[np.float64]).shape == (16,)
    assert_type(robot.base.drive(0.1), Call[int]).get()
    assert_type(robot.turret.get(), Future[float])


def test_the_synchronous_twin_returns_values(simulation: Simulation) -> None:
    with connect("b", fleet=simulation.fleet) as eal:
        before = assert_type(eal.pose.get(), PoseEstimate)
        assert assert_type(eal.base.drive(0.2), int) == 1
        eal.base.turn(90)
        eal.base.go_to(before.x_m, before.y_m)
        eal.base.follow([(before.x_m + 0.1, before.y_m)])
        eal.base.set_velocity(0.1)
        after = eal.pose.get()
        assert math.hypot(after.x_m - before.x_m - 0.1, after.y_m - before.y_m) < 0.1
        assert assert_type(eal.camera.frame(), NDArray[np.uint8]).ndim == 3
        assert 0 < assert_type(eal.battery.get(), float) <= 1
        assert assert_type(eal.cliff.get(), bool) is False
        assert eal.base.stop() == 1
        base = eal.base
    with pytest.raises(UnavailableError, match="closed"):
        base.drive(1)
    with pytest.raises(UnavailableError, match="closed"):
        eal.tasks()


def test_the_twins_have_the_same_parts_and_calls() -> None:
    def calls(kind: type, part: str) -> set[str]:
        handle = getattr(kind, part).fget.__annotations__["return"].split("[")[0]
        module = __import__(getattr(kind, part).fget.__module__, fromlist=[handle])
        return {name for name in dir(getattr(module, handle)) if not name.startswith("_")} - {"resource"}

    parts = [name for name, member in vars(RobotHandle.__mro__[1]).items() if isinstance(member, property)]
    assert "base" in parts
    for part in parts:
        assert calls(RobotHandle, part) == calls(EAL, part), part


def test_a_part_that_a_robot_lacks_is_said(simulation: Simulation) -> None:
    with pytest.raises(ResourceNotFoundError, match="Turret"):
        simulation["b"].turret.turn(1)


def test_what_is_no_number_is_refused(simulation: Simulation) -> None:
    for amount in (math.nan, math.inf):
        assert isinstance(simulation["a"].base.drive(amount).exception(), ArgumentError)
        assert isinstance(simulation["a"].base.go_to(amount, 0).exception(), ArgumentError)


def test_a_handle_outlives_the_robots_connection() -> None:
    with Fleet.load("sim") as fleet:
        base = fleet["roomba-1"].base
    assert isinstance(base.drive(1).exception(), UnavailableError)
