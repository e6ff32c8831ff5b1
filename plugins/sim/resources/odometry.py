"""Where a simulated robot believes it is."""

from __future__ import annotations

import math

import numpy as np

from eal_actors.plugin import ArgumentError, DataType, EALData, ResourceType, ValueInfo, request

from ..robot import SimRobot
from ..sensors import wrapped_rad
from ..wheels import DeadReckoning
from ..world import SimWorld
from .on_robot import OnRobot


class Odometry(OnRobot):
    """Pose by dead reckoning from the wheel encoders: x in m, y in m, yaw in rad, from (0, 0, 0) at first."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape=(3,), description="x_m, y_m, yaw_rad")

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        super().__init__(world, robot)
        with world.caught_up():
            if robot.odometer is None:
                robot.odometer = DeadReckoning(robot.make.track_m, robot.travel_m)
            self._reckoning = robot.odometer

    def get_value(self) -> EALData:
        """Return [x_m, y_m, yaw_rad], yaw in (-pi, pi]."""
        with self._world.caught_up() as now_s:
            x_m, y_m, yaw_rad = self._reckoning.pose
        pose = np.array([x_m, y_m, wrapped_rad(yaw_rad)])
        return EALData.of(pose, frame_id=f"{self._robot.name}/odom", stamp_s=now_s)

    def glance(self) -> EALData:
        """See Resource: the world is there for any thread."""
        return self.get_value()

    def set_value(self, data: EALData) -> None:
        """Set the pose that it goes on from.

        Raises:
            ArgumentError: part of it is no number.
        """
        x_m, y_m, yaw_rad = (float(part) for part in data.value)
        if not all(map(math.isfinite, (x_m, y_m, yaw_rad))):
            raise ArgumentError(f"a pose must consist of finite numbers, not {x_m:g}, {y_m:g}, {yaw_rad:g}")
        with self._world.caught_up():
            self._reckoning.pose = (x_m, y_m, yaw_rad)

    @request("travel", ValueInfo(DataType.DOUBLE, "m", shape=(2,)))
    def travel(self) -> EALData:
        """Return what the left and the right encoder have counted since the start."""
        with self._world.caught_up() as now_s:
            travel_m = self._robot.travel_m
        return EALData.of(np.array(travel_m), unit="m", stamp_s=now_s)
