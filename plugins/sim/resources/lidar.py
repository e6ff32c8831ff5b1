"""A scanning lidar: distances along the rays of its field of view."""

from __future__ import annotations

import math

import numpy as np

from eal_actors.plugin import (
    DataType,
    EALData,
    Field,
    PluginSettingsModel,
    ValueInfo,
    request,
)

from ..robot import SimRobot
from ..sensors import Array, WorldArrays, shared
from ..world import SimWorld
from .ranging import MOST_RANGE_M, RangingResource


class LidarSettings(PluginSettingsModel):
    """A lidar of a robot. The defaults are those of a small one for indoors."""

    rays: int = Field(default=360, ge=2, le=4096)
    """Rays of a scan."""
    fov_deg: float = Field(default=360.0, gt=0, le=360)
    """Field of view, centred straight ahead."""
    max_range_m: float = Field(default=8.0, gt=0, le=MOST_RANGE_M)
    """Greatest range."""
    noise_m: float = Field(default=0.01, ge=0, le=1)
    """Standard deviation of each distance."""

    @property
    def angles_rad(self) -> Array:
        """The angles of the rays from straight ahead, ascending, counter-clockwise positive.

        A scan all round begins straight behind, and its last ray is one pitch short of that. Any other scan begins at
        the right edge of the field of view and ends at the left one.
        """
        half_rad = math.radians(self.fov_deg) / 2
        return np.linspace(-half_rad, half_rad, self.rays, endpoint=self.fov_deg < 360)


class Lidar(RangingResource):
    """Distances from the robot's centre along the rays of a scan, counter-clockwise; the greatest range for no hit.

    All rays of a scan are measured at the same time.
    """

    value = ValueInfo(DataType.DOUBLE, "m", shape=(None,))
    settings_key = "lidar"

    def __init__(self, world: SimWorld, robot: SimRobot, settings: LidarSettings) -> None:
        noise = robot.noise_source(self.settings_key)
        super().__init__(world, robot, settings.noise_m, settings.max_range_m, noise)
        self._angles_rad = settings.angles_rad

    def get_value(self) -> EALData:
        """Return the distances, the greatest range where a ray hits nothing; noise does not exceed that range."""
        return self._read(lambda _: self._scan_m(), "m", "base")

    @request("angles", ValueInfo(DataType.DOUBLE, "rad", shape=(None,)))
    def angles(self) -> EALData:
        """Return the rays' angles from straight ahead, ascending, counter-clockwise positive."""
        return EALData.of(self._angles_rad, unit="rad", frame_id=f"{self._robot.name}/base")

    def _scan_m(self) -> Array:
        """Return a scan. Thread: holds the world's `lock`."""
        arrays = shared(self._world, WorldArrays)
        arrays.update(self._world)
        own = arrays.column_of(self._robot.name)
        x_m, y_m, yaw_rad = self._robot.pose
        ux, uy = (part(yaw_rad + self._angles_rad)[:, np.newaxis] for part in (np.cos, np.sin))
        enter_m, leave_m = arrays.spans_m(x_m, y_m, ux, uy)
        enter_m[:, own] = np.inf
        met_m = np.where((enter_m <= leave_m) & (enter_m >= 0.0), enter_m, np.inf).min(axis=1)
        found_m = np.minimum(met_m, arrays.to_walls_m(np.array(x_m), np.array(y_m), ux[:, 0], uy[:, 0]))
        return self._measured(found_m)
