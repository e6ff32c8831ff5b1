"""The poses of a simulated robot: the true one, the estimate and the one by odometry."""

from __future__ import annotations

import math

import numpy as np
from typing_extensions import override

from eal_actors.plugin import (
    Clock,
    DataType,
    EALData,
    Localizer,
    PoseResource,
    Resource,
    ResourceType,
    ValueInfo,
    finite_pose,
    request,
)

from ..arena import Pose2D
from ..robot import SimRobot
from ..world import SimWorld
from .robot_resource import RobotResource


class TruePose(RobotResource):
    """The robot's true x in m, y in m and yaw in rad, in (-pi, pi], counter-clockwise from the world's x axis."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape=(3,), description="x_m, y_m, yaw_rad")

    def get_value(self) -> EALData:
        """Return [x_m, y_m, yaw_rad]."""
        with self._world.lock:
            now_s = self._world.catch_up()
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
        pose = finite_pose(data)
        with self._world.lock:
            self._world.catch_up()
            self._world.carry(self._robot, pose)


class Pose(PoseResource):
    """The estimated x in m, y in m and yaw in rad, in (-pi, pi], counter-clockwise from the map's x axis.

    The estimate begins at the robot's true place. From then on it knows what the odometry and fixes say.
    """

    def __init__(
        self, world: SimWorld, robot: SimRobot, localizer: Localizer, clock: Clock, *, is_calibrated: bool
    ) -> None:
        super().__init__(localizer, clock)
        self._world = world
        self._robot = robot
        noise = robot.make.odometry_noise
        with world.lock:
            world.catch_up()
            robot.hand_over_reports()
            if robot.has_place:
                localizer.begin_at(*robot.pose)
            localizer.attach(noise.calibrated() if is_calibrated else noise, refresh=self._refresh)
            robot.begin_odometry()
            robot.localizer = localizer

    not_ready = Resource.not_ready  # it never waits for a device

    @override
    def get_value(self) -> EALData:
        """Return [x_m, y_m, yaw_rad]."""
        data = super().get_value()
        return EALData.of(np.array(data.value), frame_id=data.frame_id, stamp_s=data.stamp_s)

    def _refresh(self) -> None:
        with self._world.lock:
            now_s = self._world.catch_up()
            self._robot.report_odometry(now_s)
            self._robot.hand_over_reports()


class Odometry(RobotResource):
    """Pose by dead reckoning from the wheel encoders: x in m, y in m, yaw in rad, from (0, 0, 0) at first."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape=(3,), description="x_m, y_m, yaw_rad")

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        super().__init__(world, robot)
        with world.lock:
            world.catch_up()
            robot.begin_odometry()

    def get_value(self) -> EALData:
        """Return [x_m, y_m, yaw_rad], yaw in (-pi, pi]."""
        with self._world.lock:
            now_s = self._world.catch_up()
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
        pose = finite_pose(data)
        with self._world.lock:
            now_s = self._world.catch_up()
            self._robot.odometry = pose
            self._robot.hand_over_reports()
            if self._robot.localizer is not None:
                self._robot.localizer.restart_odometry(*pose, now_s)

    @request("travel", ValueInfo(DataType.DOUBLE, "m", shape=(2,)))
    def travel(self) -> EALData:
        """Return the totals of the left and the right encoder since the start."""
        return self._read(lambda _: np.array(self._robot.travel_m), "m")


def _pose_data(pose: Pose2D, frame_id: str, now_s: float) -> EALData:
    x_m, y_m, yaw_rad = pose
    return EALData.of(np.array([x_m, y_m, math.remainder(yaw_rad, math.tau)]), frame_id=frame_id, stamp_s=now_s)
