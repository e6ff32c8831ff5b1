"""From where a robot stands to where it is to be: the commands of its Base."""

from __future__ import annotations

import math
from collections.abc import Sequence

from eal_actors.lab.choreography.assigning import Point


def turn_command(yaw_rad: float, to_rad: float) -> str:
    """Return the command that turns a robot from one heading to another, the shorter way round."""
    left_deg = math.degrees((to_rad - yaw_rad + math.pi) % (2 * math.pi) - math.pi)
    return f"{'l' if left_deg > 0 else 'r'}{abs(left_deg):.4f}"


def leg_commands(pose: Sequence[float], goal: Point, longest_m: float) -> tuple[str, str]:
    """Return the turn towards a goal, and the way to it or the first part of that.

    Args:
        pose: x in m, y in m, yaw in rad.
        goal: where to go.
        longest_m: how far to go at most, before it is time to aim again.
    """
    dx_m, dy_m = goal[0] - pose[0], goal[1] - pose[1]
    return turn_command(pose[2], math.atan2(dy_m, dx_m)), f"f{min(longest_m, math.hypot(dx_m, dy_m)):.4f}"
