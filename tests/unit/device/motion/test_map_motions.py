"""The goals of motions to places."""

from __future__ import annotations

import math

import pytest

from eal_actors.device.motion.map_motions import MapMotions
from eal_actors.kernel.errors import ArgumentError


@pytest.mark.parametrize("yaw_deg", [90.0, -90.0, 13.0])
def test_a_heading_in_degrees_is_refused(yaw_deg: float) -> None:
    """`goto [1, 2, 90]` turned by 90 radians without a word."""
    with pytest.raises(ArgumentError, match=f"in radians, not {yaw_deg:g}; `go_to` takes degrees"):
        MapMotions.goal_numbers([1.0, 2.0, yaw_deg])


@pytest.mark.parametrize("yaw_rad", [math.pi, -3.5 * math.pi, None])
def test_a_heading_in_radians_may_be_more_than_a_turn(yaw_rad: float | None) -> None:
    goal = [1.0, 2.0] if yaw_rad is None else [1.0, 2.0, yaw_rad]
    assert MapMotions.goal_numbers(goal) == (1.0, 2.0, yaw_rad)
