"""Where a simulated robot truly is."""

from __future__ import annotations

import math

import numpy as np

from eal_actors.plugin import ArgumentError, DataType, EALData, ResourceType, ValueInfo

from ..sensors import wrapped_rad
from .on_robot import OnRobot


class Pose(OnRobot):
    """The robot's true x in m, y in m and yaw in rad, in (-pi, pi], counter-clockwise from the world's x axis."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape=(3,), description="x_m, y_m, yaw_rad")

    def get_value(self) -> EALData:
        """Return [x_m, y_m, yaw_rad]."""
        with self._world.caught_up() as now_s:
            x_m, y_m, yaw_rad = self._robot.pose
        pose = np.array([x_m, y_m, wrapped_rad(yaw_rad)])
        return EALData.of(pose, frame_id="world", stamp_s=now_s)

    def glance(self) -> EALData:
        """See Resource: the world is there for any thread."""
        return self.get_value()

    def set_value(self, data: EALData) -> None:
        """Put the robot elsewhere, as a person would who carries it there.

        Raises:
            ArgumentError: part of it is no number, or that place is not free.
            UnavailableError: the robot is driven.
        """
        x_m, y_m, yaw_rad = (float(part) for part in data.value)
        if not all(map(math.isfinite, (x_m, y_m, yaw_rad))):
            raise ArgumentError(f"a pose must consist of finite numbers, not {x_m:g}, {y_m:g}, {yaw_rad:g}")
        with self._world.caught_up():
            self._world.carry(self._robot, (x_m, y_m, yaw_rad))
