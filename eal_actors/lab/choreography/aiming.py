"""Commands of a Base that move a robot from its pose to a goal."""

from __future__ import annotations

import math
from collections.abc import Sequence

from eal_actors.lab.choreography.assigning import Point


def turn_command(yaw_rad: float, to_rad: float) -> str:
    """Return the command that turns a robot from one heading to another in the shorter direction."""
    left_deg = math.degrees((to_rad - yaw_rad + math.pi) % (2 * math.pi) - math.pi)
    return f"{'l' if left_deg > 0 else 'r'}{abs(left_deg):.4f}"


def leg_commands(pose: Sequence[float], goal: Point, longest_m: float) -> tuple[str, str]:
    """Return the commands that turn towards a goal and drive to it.

    Args:
        pose: x in m, y in m, yaw in rad.
        goal: x in m, y in m.
        longest_m: longest drive; a more distant goal needs further legs, each of which aims again.
    """
    dx_m, dy_m = goal[0] - pose[0], goal[1] - pose[1]
    return turn_command(pose[2], math.atan2(dy_m, dx_m)), f"f{min(longest_m, math.hypot(dx_m, dy_m)):.4f}"
