"""The base class of the simulated sensors that measure distances."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from eal_actors.plugin import DataType, ResourceType, ValueInfo, setting

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
        noise_m: standard deviation of a distance; for a depth camera, of a depth of 1 m.
    """

    types = ResourceType.SENSOR

    noise_m: float = setting(
        ValueInfo(DataType.DOUBLE, "m", 0, 1),
        "Standard deviation of a distance; for a depth camera, of a depth of 1 m.",
    )
    max_range_m: float = setting(
        ValueInfo(DataType.DOUBLE, "m", 0.1, MOST_RANGE_M), "Greatest range; anything farther away is not seen."
    )

    def __init__(
        self, world: SimWorld, robot: SimRobot, noise_m: float, max_range_m: float, generator: Generator
    ) -> None:
        super().__init__(world, robot)
        self.noise_m = noise_m
        self.max_range_m = max_range_m
        self._generator = generator

    def _measured(self, found_m: Array, spread: Array | float = 1.0) -> Array:
        """Return distances as the sensor measures them: with noise, which does not exceed the greatest range.

        `spread` is a factor of the noise.
        """
        if self.noise_m:
            noise_m = self.noise_m * spread * self._generator.standard_normal(found_m.shape)
            found_m = np.where(found_m < self.max_range_m, np.maximum(found_m + noise_m, 0.0), found_m)
        return np.asarray(np.minimum(found_m, self.max_range_m))
