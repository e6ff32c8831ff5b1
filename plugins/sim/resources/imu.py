"""An inertial measurement unit in the robot's centre: accelerations and turn rates.

Source of the default noise: MPU-6000 and MPU-6050 Product Specification, InvenSense PS-MPU-6000A-00: a turn rate of
0.05 degrees per second (rms), and 400 micro-g per root hertz of acceleration, at a bandwidth of 100 Hz.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from eal_actors.plugin import DataType, EALData, Field, PluginSettingsModel, ResourceType, ValueInfo, request

from ..robot import SimRobot
from ..sensors import Array
from ..world import SimWorld
from .robot_resource import RobotResource

_GRAVITY_M_S2: Final = 9.81
_AXES: Final = 3


class ImuSettings(PluginSettingsModel):
    """An inertial measurement unit of a robot."""

    acceleration_noise_m_s2: float = Field(default=0.04, ge=0, le=10)
    """Standard deviation of each acceleration."""
    acceleration_bias_m_s2: float = Field(default=0.05, ge=0, le=10)
    """Standard deviation of the constant error of each axis, which the seed determines."""
    turn_rate_noise_rad_s: float = Field(default=0.0009, ge=0, le=1)
    """Standard deviation of each turn rate."""
    turn_rate_bias_rad_s: float = Field(default=0.002, ge=0, le=1)
    """Standard deviation of the constant error of each axis, which the seed determines."""


class Imu(RobotResource):
    """Acceleration and turn rate in the frame of the robot: x ahead, y to the left, z up.

    The acceleration is what a sensor on a real robot measures: at rest 9.81 m/s^2 up. Values are means over the last
    tick of the world.
    """

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape=(6,), description="ax, ay, az in m/s^2, then wx, wy, wz in rad/s")
    settings_key = "imu"

    def __init__(self, world: SimWorld, robot: SimRobot, settings: ImuSettings) -> None:
        super().__init__(world, robot)
        self._noise = robot.noise_source(self.settings_key)
        noises = settings.acceleration_noise_m_s2, settings.turn_rate_noise_rad_s
        biases = settings.acceleration_bias_m_s2, settings.turn_rate_bias_rad_s
        self._deviations = np.repeat(noises, _AXES)
        self._bias = np.repeat(biases, _AXES) * self._noise.standard_normal(2 * _AXES)

    def get_value(self) -> EALData:
        """Return [ax, ay, az, wx, wy, wz]: accelerations in m/s^2 and turn rates in rad/s."""
        return self._read(lambda _: self._measure(), frame="base")

    @request("acceleration", ValueInfo(DataType.DOUBLE, "m/s^2", shape=(3,)))
    def acceleration(self) -> EALData:
        """Return a new measurement of the acceleration alone."""
        return self._read(lambda _: self._measure()[:_AXES], "m/s^2", "base")

    @request("turn_rate", ValueInfo(DataType.DOUBLE, "rad/s", shape=(3,)))
    def turn_rate(self) -> EALData:
        """Return a new measurement of the turn rates alone."""
        return self._read(lambda _: self._measure()[_AXES:], "rad/s", "base")

    def _measure(self) -> Array:
        """Return a measurement. Thread: holds the world's `lock`."""
        first, second, (_, _, yaw_rad) = poses = self._robot.recent_poses
        places = np.array([pose[:2] for pose in poses])
        velocities = np.diff(places, axis=0) / self._world.tick_s
        east, north = (velocities[1] - velocities[0]) / self._world.tick_s
        heading_rad = first[2] + (yaw_rad - first[2]) / 2  # of the middle of both ticks
        cos, sin = math.cos(heading_rad), math.sin(heading_rad)
        turn_rate = (yaw_rad - second[2]) / self._world.tick_s
        true = np.array([cos * east + sin * north, cos * north - sin * east, _GRAVITY_M_S2, 0.0, 0.0, turn_rate])
        return true + self._bias + self._deviations * self._noise.standard_normal(2 * _AXES)
