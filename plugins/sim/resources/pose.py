"""The true pose of a simulated robot, and its pose by odometry."""

from __future__ import annotations

import math

import numpy as np
from typing_extensions import override

from eal_actors.plugin import ArgumentError, DataType, EALData, ResourceType, ValueInfo, request

from ..arena import Pose2D
from ..robot import SimRobot, wrapped_rad
from ..world import SimWorld
from .robot_resource import RobotResource


class Pose(RobotResource):
    """The robot's true x in m, y in m and yaw in rad, in (-pi, pi], counter-clockwise from the world's x axis."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape=(3,), description="x_m, y_m, yaw_rad")

    def get_value(self) -> EALData:
        """Return [x_m, y_m, yaw_rad]."""
        with self._world.caught_up() as now_s:
            pose = self._robot.pose
        return _pose_data(pose, "world", now_s)

    @override
    def glance(self) -> EALData:
        return self.get_value()  # any thread may read the world

    def set_value(self, data: EALData) -> None:
        """Move the robot to another place, as a person would carry it.

        Raises:
            ArgumentError: a number is not finite, or that place is not free.
            UnavailableError: the robot is driven.
        """
        pose = _checked_pose(data)
        with self._world.caught_up():
            self._world.carry(self._robot, pose)


class Odometry(RobotResource):
    """Pose by dead reckoning from the wheel encoders: x in m, y in m, yaw in rad, from (0, 0, 0) at first."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape=(3,), description="x_m, y_m, yaw_rad")

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        super().__init__(world, robot)
        with world.caught_up():
            robot.begin_odometry()

    def get_value(self) -> EALData:
        """Return [x_m, y_m, yaw_rad], yaw in (-pi, pi]."""
        with self._world.caught_up() as now_s:
            pose = self._robot.odometry
        return _pose_data(pose, f"{self._robot.name}/odom", now_s)

    @override
    def glance(self) -> EALData:
        return self.get_value()  # any thread may read the world

    def set_value(self, data: EALData) -> None:
        """Set the pose to continue from.

        Raises:
            ArgumentError: a number is not finite.
        """
        pose = _checked_pose(data)
        with self._world.caught_up():
            self._robot.odometry = pose

    @request("travel", ValueInfo(DataType.DOUBLE, "m", shape=(2,)))
    def travel(self) -> EALData:
        """Return the totals of the left and the right encoder since the start."""
        return self._read(lambda _: np.array(self._robot.travel_m), "m")


def _pose_data(pose: Pose2D, frame_id: str, now_s: float) -> EALData:
    x_m, y_m, yaw_rad = pose
    return EALData.of(np.array([x_m, y_m, wrapped_rad(yaw_rad)]), frame_id=frame_id, stamp_s=now_s)


def _checked_pose(data: EALData) -> Pose2D:
    x_m, y_m, yaw_rad = (float(part) for part in data.value)
    if not all(map(math.isfinite, (x_m, y_m, yaw_rad))):
        raise ArgumentError(f"a pose must consist of finite numbers, not {x_m:g}, {y_m:g}, {yaw_rad:g}")
    return x_m, y_m, yaw_rad
