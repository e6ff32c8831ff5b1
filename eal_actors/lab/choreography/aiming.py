"""Commands of a Base that move a robot from its pose to a goal."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from eal_actors.actors.handles import RobotHandle
from eal_actors.device.navigation.traffic.lattice import Point
from eal_actors.kernel.errors import UnavailableError


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


def commands_to(
    robot: RobotHandle, goal: Point, near_m: float, *, longest_m: float = 1.0, most_legs: int = 200
) -> Iterator[str]:
    """Yield the commands of a robot's Base that take it to a goal, aimed again from its TruePose after each leg.

    Args:
        robot: the robot; each command must be done before the next one is asked for.
        goal: where to go, in the map frame.
        near_m: how near the goal is near enough.
        longest_m: length of a leg; wheels err, so long legs miss the goal.
        most_legs: number of legs after which to give up.

    Raises:
        UnavailableError: the robot is not at the goal after `most_legs` legs.

    Thread: blocks the caller while the robot is asked for its pose.
    """
    for _ in range(most_legs):
        pose = robot["TruePose"].get_value().get().value
        if math.dist(pose[:2], goal) <= near_m:
            return
        yield from leg_commands(pose, goal, longest_m)
    raise UnavailableError(f"did not reach ({goal[0]:g}, {goal[1]:g}) in {most_legs} legs", robot=robot.name)


def drive_to(robot: RobotHandle, goal: Point, near_m: float, *, longest_m: float = 1.0, most_legs: int = 200) -> None:
    """Drive a robot to a goal; see `commands_to`. Thread: blocks the caller until the robot has arrived."""
    for command in commands_to(robot, goal, near_m, longest_m=longest_m, most_legs=most_legs):
        robot["Base"].send_cmd(command).get()
