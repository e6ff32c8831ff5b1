"""The base class of the simulated sensors that measure distances."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from eal_actors.plugin import DataType, ResourceType, ValueInfo, config, config_setter

from ..robot import SimRobot
from ..sensors import Array
from ..world import SimWorld
from .robot_resource import RobotResource

if TYPE_CHECKING:
    from numpy.random import Generator

MOST_RANGE_M: Final = 100.0


class RangingResource(RobotResource):
    """A sensor of distances, with normal noise and a greatest range.

    Args:
        world: the world of the robot.
        robot: the robot.
        noise_m: standard deviation of a distance; for a depth camera, of a depth of 1 m.
        max_range_m: greatest range.
        generator: source of the noise.
    """

    types = ResourceType.SENSOR

    def __init__(
        self, world: SimWorld, robot: SimRobot, noise_m: float, max_range_m: float, generator: Generator
    ) -> None:
        super().__init__(world, robot)
        self._noise_m = noise_m
        self._max_range_m = max_range_m
        self._generator = generator

    @config("noise_m", ValueInfo(DataType.DOUBLE, "m", 0, 1))
    def noise_m(self) -> float:
        """Standard deviation of a distance; for a depth camera, of a depth of 1 m."""
        return self._noise_m

    @config_setter("noise_m")
    def set_noise_m(self, noise_m: float) -> None:
        """Set the noise of later values."""
        self._noise_m = float(noise_m)

    @config("max_range_m", ValueInfo(DataType.DOUBLE, "m", 0.1, MOST_RANGE_M))
    def max_range_m(self) -> float:
        """Greatest range; anything farther away is not seen."""
        return self._max_range_m

    @config_setter("max_range_m")
    def set_max_range_m(self, max_range_m: float) -> None:
        """Set the greatest range of later values."""
        self._max_range_m = float(max_range_m)

    def _measured(self, found_m: Array, spread: Array | float = 1.0) -> Array:
        """Return distances as the sensor measures them: with noise, which does not exceed the greatest range.

        Args:
            found_m: the true distances, of any shape.
            spread: factor of the noise.
        """
        if self._noise_m:
            noise_m = self._noise_m * spread * self._generator.standard_normal(found_m.shape)
            found_m = np.where(found_m < self._max_range_m, np.maximum(found_m + noise_m, 0.0), found_m)
        return np.asarray(np.minimum(found_m, self._max_range_m))
