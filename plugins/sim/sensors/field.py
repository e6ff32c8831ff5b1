"""Sensors of distant sources: compass, light and beacons.

The sensors sit on top of the robot. An obstacle or a box that rises above the line of sight blocks it. Robots and
beacons do not.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from eal_actors.plugin import wrapped_rad

from ..robot import SimRobot
from ..world import SimWorld
from .arrays import WorldArrays, shared
from .geometry import Array

if TYPE_CHECKING:
    from numpy.typing import NDArray


def compass_rad(robot: SimRobot, noise_rad: float) -> float:
    """Return the robot's yaw in (-pi, pi]; a noise of 0 draws no random number.

    Raises:
        UnavailableError: the robot has no place in the world.
    """
    _, _, yaw_rad = robot.pose
    if noise_rad:
        yaw_rad += noise_rad * float(robot.sensor_generator.standard_normal())
    return wrapped_rad(yaw_rad)


def light_lux(world: SimWorld, robot: SimRobot) -> float:
    """Return the light on the top of the robot: the ambient light and that of the lamps in sight.

    A lamp is isotropic: it gives lumens / (4 pi d²), times the cosine of its angle from the zenith.

    Raises:
        UnavailableError: the robot has no place in the world.
    """
    lighting = world.model.lighting
    x_m, y_m, _ = robot.pose
    if not lighting.lamps:
        return lighting.ambient_lux
    eye = np.array([x_m, y_m, robot.make.height_m])
    lamps = np.array([(lamp.x_m, lamp.y_m, lamp.z_m) for lamp in lighting.lamps])
    lumens = np.array([lamp.lumens for lamp in lighting.lamps])
    above_m = np.maximum(lamps[:, 2] - eye[2], 0.0)
    square_m2 = np.square(lamps - eye).sum(axis=1)
    lux = lumens / (4 * math.pi) * above_m / square_m2**1.5
    return lighting.ambient_lux + float(lux[_in_sight(world, eye, lamps)].sum())


def seen_beacons(world: SimWorld, robot: SimRobot) -> Array:
    """Return the bearing_rad, in (-pi, pi] from straight ahead, and distance_m of each beacon's centre.

    Returns:
        Shape (n, 2), in the order of the world file; NaN for a beacon out of reach or out of sight. The line of
        sight ends at the beacon's top.

    Raises:
        UnavailableError: the robot has no place in the world.
    """
    x_m, y_m, yaw_rad = robot.pose
    beacons = world.model.beacons
    if not beacons:
        return np.empty((0, 2))
    eye = np.array([x_m, y_m, robot.make.height_m])
    tops = np.array([(beacon.x_m, beacon.y_m, beacon.height_m) for beacon in beacons])
    in_sight = _in_sight(world, eye, tops).tolist()
    found = np.full((len(beacons), 2), np.nan)
    for row, beacon in enumerate(beacons):
        dx, dy = beacon.x_m - x_m, beacon.y_m - y_m
        distance_m = math.hypot(dx, dy)
        if in_sight[row] and distance_m <= beacon.reach_m:
            found[row] = wrapped_rad(math.atan2(dy, dx) - yaw_rad), distance_m
    return found


def _in_sight(world: SimWorld, eye: Array, targets: Array) -> NDArray[np.bool_]:
    """Return which targets, shape (n, 3), have a free line of sight to the eye, shape (3,)."""
    arrays = shared(world, WorldArrays)
    arrays.update(world)
    to = (targets - eye)[:, :, np.newaxis]
    distance_m = np.maximum(np.hypot(to[:, 0], to[:, 1]), 1e-9)  # horizontal; a lamp may hang right above
    ux, uy, slope = to[:, 0] / distance_m, to[:, 1] / distance_m, to[:, 2] / distance_m
    enter_m, leave_m = (span[:, arrays.first_opaque :] for span in arrays.spans_m(eye[0], eye[1], ux, uy))
    enter_m, leave_m = np.maximum(enter_m, 0.0), np.minimum(leave_m, distance_m)
    lowest_m = eye[2] + np.minimum(slope * enter_m, slope * leave_m)
    hidden = ((enter_m < leave_m) & (arrays.height_m[arrays.first_opaque :] > lowest_m)).any(axis=1)
    return np.asarray(~hidden)
