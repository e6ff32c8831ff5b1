"""Drives by a distance that something holds up: no `done` for a robot that is not where its encoders count."""

from __future__ import annotations

import math
from typing import Any

import pytest

from eal_actors.kernel.errors import BlockedError
from tests.motion.rig import DRIVERS, TrackedRobot, tracked

KINDS = ("sim-evbot2", "sim-evbot3", "sim-roomba", *DRIVERS)
WALL_M = 0.9


def world(*, crate: bool = False) -> dict[str, Any]:
    """Return a floor with a wall ahead of the robot, or with a crate that it can push."""
    floor: dict[str, Any] = {"version": 1, "name": "floor", "size_m": [6, 6]}
    if crate:
        return floor | {"boxes": [{"name": "crate", "x_m": 0.7, "y_m": 0.0, "size_m": [0.3, 0.3], "mass_kg": 1.0}]}
    return floor | {"obstacles": [{"kind": "wall", "start_m": [WALL_M, -1.0], "end_m": [WALL_M, 1.0]}]}


def outcome(it: TrackedRobot, command: str) -> tuple[BaseException | None, float]:
    """Return the failure of a command, and how far the robot has truly come."""
    x_m, y_m, _ = it.true_pose()
    motion = it.robot["Base"].send_cmd(command)
    while not motion.done():
        it.simulation.advance(0.1)
    return motion.exception(), math.dist(it.true_pose()[:2], (x_m, y_m))


@pytest.mark.parametrize("kind", KINDS)
def test_a_wall_in_the_way_is_said_and_the_robot_stands(kind: str) -> None:
    with tracked(kind, 0, world()) as it:
        begun_s = it.simulation.now_s
        error, gone_m = outcome(it, "f1.2")
        assert isinstance(error, BlockedError), (error, gone_m)
        assert "something holds it" in str(error)
        assert 0.6 < gone_m < WALL_M
        assert it.simulation.now_s - begun_s < gone_m / 0.2 + 1.0, "it does not push on"
        assert it.robot["Base"].get_status().get() == 0


@pytest.mark.parametrize("kind", ["sim-evbot3", "evbot3", "oi"])
def test_a_touch_at_the_very_end_is_done_only_if_it_is_nearly_there(kind: str) -> None:
    with tracked(kind, 0, world()) as it:
        for _ in range(2):
            error, gone_m = outcome(it, "f0.4")
            assert isinstance(error, BlockedError) or gone_m > 0.35, (error, gone_m)


@pytest.mark.parametrize("kind", ["sim-evbot3", "sim-roomba", "evbot3", "sci"])
def test_a_crate_that_gives_way_is_pushed(kind: str) -> None:
    with tracked(kind, 0, world(crate=True)) as it:
        error, gone_m = outcome(it, "f1")
        assert error is None, error
        assert gone_m == pytest.approx(1.0, abs=0.05)
