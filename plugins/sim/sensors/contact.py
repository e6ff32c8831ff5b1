"""Sensors of the floor under a robot and of objects very close to it."""

from __future__ import annotations

import math
from typing import Final

from eal_actors.device.world import WorldModel
from eal_actors.plugin import wrapped_rad

from ..arena import distances_to_drops_m
from ..robot import SimRobot
from ..world import SimWorld

_BUMPER_REACH_M: Final = 0.003
_BUMPERS_OVERLAP_RAD: Final = math.radians(10)
_CASTER_AHEAD: Final = 0.8  # of the radius
_CLIFF_BEARINGS_RAD: Final = tuple(math.radians(bearing_deg) for bearing_deg in (60, 20, -20, -60))
_WALL_BEARING_RAD: Final = math.radians(-70)
_WALL_REACH_M: Final = 0.05


def pressed_bumpers(robot: SimRobot) -> tuple[bool, bool]:
    """Return whether the left and the right half of the front bumper are pressed; a contact ahead presses both.

    Raises:
        UnavailableError: the robot has no place in the world.
    """
    x_m, y_m, yaw_rad = robot.pose
    if robot.faults.blocked_ahead:
        return True, True
    reach_m = robot.make.radius_m + _BUMPER_REACH_M
    left = right = False
    for hit in robot.space.point_query((x_m, y_m), reach_m, robot.filter):
        bearing = wrapped_rad(math.atan2(hit.point.y - y_m, hit.point.x - x_m) - yaw_rad)
        left |= -_BUMPERS_OVERLAP_RAD <= bearing <= math.pi / 2
        right |= -math.pi / 2 <= bearing <= _BUMPERS_OVERLAP_RAD
    return left, right


def dropped_wheels(world: SimWorld, robot: SimRobot) -> tuple[bool, bool, bool]:
    """Return whether the left wheel, the right wheel and the caster, which is in front, hang over a drop.

    Raises:
        UnavailableError: the robot has no place in the world.
    """
    arm_m, ahead_m = robot.make.track_m / 2, _CASTER_AHEAD * robot.make.radius_m
    left, right, caster = (
        _is_over_drop(world.model, robot, distance_m, bearing_rad)
        for distance_m, bearing_rad in ((arm_m, math.pi / 2), (arm_m, -math.pi / 2), (ahead_m, 0.0))
    )
    return left, right, caster


def seen_cliffs(world: SimWorld, robot: SimRobot) -> tuple[bool, bool, bool, bool]:
    """Return whether each of the sensors along the front edge is over a drop, from the left to the right.

    Raises:
        UnavailableError: the robot has no place in the world.
    """
    edge_m = robot.make.radius_m
    left, front_left, front_right, right = (
        _is_over_drop(world.model, robot, edge_m, bearing_rad) for bearing_rad in _CLIFF_BEARINGS_RAD
    )
    return left, front_left, front_right, right


def is_wall_near(robot: SimRobot) -> bool:
    """Return whether something is within 5 cm of the hull at the right-hand side, a little ahead.

    Raises:
        UnavailableError: the robot has no place in the world.
    """
    x_m, y_m, yaw_rad = robot.pose
    end = _point((x_m, y_m, yaw_rad), robot.make.radius_m + _WALL_REACH_M, _WALL_BEARING_RAD)
    return robot.space.segment_query_first((x_m, y_m), end, 0.0, robot.filter) is not None


def _point(pose: tuple[float, float, float], distance_m: float, bearing_rad: float) -> tuple[float, float]:
    """Return the point at a distance and bearing from a robot."""
    x_m, y_m, yaw_rad = pose
    return x_m + distance_m * math.cos(yaw_rad + bearing_rad), y_m + distance_m * math.sin(yaw_rad + bearing_rad)


def _is_over_drop(model: WorldModel, robot: SimRobot, distance_m: float, bearing_rad: float) -> bool:
    return 0.0 in distances_to_drops_m(model, *_point(robot.pose, distance_m, bearing_rad))
