"""A depth camera: the distance ahead of what each pixel shows.

Source of the default noise: K. Khoshelham and S. Oude Elberink, "Accuracy and Resolution of Kinect Depth Data for
Indoor Mapping Applications", Sensors 12 (2), 2012: the random error grows with the square of the depth, to 4 cm at 5 m.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from eal_actors.plugin import (
    DataType,
    EALData,
    Field,
    PluginSettingsModel,
    ValueInfo,
    request,
)

from ..camera.eye import Eye, PinholeLens
from ..models import outline_m
from ..robot import SimRobot
from ..sensors import Array, WorldArrays, disc_span_m, shared
from ..world import SimWorld
from .camera import mounted_eye
from .ranging import MOST_RANGE_M, RangingResource

if TYPE_CHECKING:
    from numpy.typing import NDArray


class DepthCameraSettings(PluginSettingsModel):
    """A depth camera of a robot. The defaults are those of a Kinect at half of its resolution."""

    width: int = Field(default=320, ge=16, le=1280)
    """Columns of the picture."""
    height: int = Field(default=240, ge=16, le=1024)
    """Rows of the picture."""
    fov_deg: float = Field(default=57.0, ge=10, le=150)
    """Field of view, from the left edge to the right edge."""
    max_range_m: float = Field(default=5.0, gt=0, le=MOST_RANGE_M)
    """Greatest depth."""
    noise_m: float = Field(default=0.0014, ge=0, le=1)
    """Standard deviation of a depth of 1 m; it grows with the square of the depth."""


class DepthCamera(RangingResource):
    """Depth camera at the place of the camera: it faces ahead, or with the turret.

    A depth is measured along the camera's axis, so that a wall straight ahead has one depth all over. Colours do not
    matter: no OpenCV is needed.
    """

    value = ValueInfo(DataType.FLOAT, "m", shape=(None, None), description="rows from the top")
    settings_key = "depth_camera"

    def __init__(self, world: SimWorld, robot: SimRobot, settings: DepthCameraSettings) -> None:
        noise = robot.noise_source(self.settings_key)
        super().__init__(world, robot, settings.noise_m, settings.max_range_m, noise)
        self._lens = PinholeLens(settings.width, settings.height, settings.fov_deg)

    def get_value(self) -> EALData:
        """Return the depths, shape (height, width); the greatest range where nothing is nearer."""
        return self._read(lambda _: self._measure(), "m", "camera")

    @request("intrinsics", ValueInfo(DataType.DOUBLE, "px", shape=(3, 3)))
    def intrinsics(self) -> EALData:
        """Return the camera matrix: from x right, y down, z ahead to pixels, the centre of the first one at 0, 0."""
        return EALData.of(self._lens.matrix, unit="px")

    def _measure(self) -> NDArray[np.float32]:
        """Return the depths with noise. Thread: holds the world's `lock`."""
        found_m = depths_m(self._world, self._robot, mounted_eye(self._world, self._robot, self._lens))
        return self._measured(found_m, found_m**2).astype(np.float32)


def depths_m(world: SimWorld, robot: SimRobot, eye: Eye) -> Array:
    """Return the true depths that a robot's camera sees, shape (height, width). Thread: holds the world's `lock`.

    Everything in the room is an upright prism on the floor. Each column of the picture is a plane through the axis of
    the prisms, so a column meets a prism from one depth to another, and only the height of the ray changes in between.
    """
    arrays = shared(world, WorldArrays)
    arrays.update(world)
    rows = np.arange(eye.lens.height, dtype=np.float64)[:, np.newaxis]
    falls = (rows - eye.centre_px[1]) / eye.focal_px  # down, per metre of depth
    ways = np.hypot(1.0, eye.slopes)  # on the floor plan, per metre of depth
    ux, uy = ((eye.ahead[axis] + eye.slopes * eye.right[axis]) / ways for axis in range(2))
    with np.errstate(divide="ignore"):  # a level ray meets neither the floor nor the ceiling
        levels_m = np.abs(np.where(falls > 0, eye.z_m, eye.z_m - world.model.height_m) / falls)
    found_m = np.minimum(levels_m, arrays.to_walls_m(np.array(eye.x_m), np.array(eye.y_m), ux, uy) / ways)
    own = arrays.column_of(robot.name)
    enter_m, leave_m = arrays.spans_m(eye.x_m, eye.y_m, ux[:, np.newaxis], uy[:, np.newaxis])
    heights_m = arrays.height_m.copy()
    for number, other in enumerate(world.robots):
        make = other.make
        (_, heights_m[number]), *heads = outline_m(make.radius_m, make.height_m, make.camera_height_m)
        if number == own or not world.is_solid:
            leave_m[:, number] = -np.inf
            continue
        for radius_m, top_m in heads:
            to = np.array(other.pose[0] - eye.x_m), np.array(other.pose[1] - eye.y_m)
            head_m = disc_span_m(*to, ux, uy, np.array(radius_m))
            _add_prism(found_m, head_m[0] / ways, head_m[1] / ways, top_m, eye.z_m, falls)
    for number in np.flatnonzero((leave_m > np.maximum(enter_m, 0.0)).any(axis=0)).tolist():
        _add_prism(found_m, enter_m[:, number] / ways, leave_m[:, number] / ways, heights_m[number], eye.z_m, falls)
    return found_m


def _add_prism(found_m: Array, enter_m: Array, leave_m: Array, top_m: float, eye_m: float, falls: Array) -> None:
    """Lower the depths where a prism on the floor is nearer.

    Args:
        found_m: the depths so far, shape (height, width); changed.
        enter_m: the depth at which each column enters the prism.
        leave_m: the depth at which it leaves it.
        top_m: height of the prism.
        eye_m: height of the camera.
        falls: by how much the rays of each row fall per metre of depth, shape (height, 1).
    """
    columns = np.flatnonzero(leave_m > np.maximum(enter_m, 0.0))
    enter_m, leave_m = enter_m[columns], leave_m[columns]
    met_m = np.where((eye_m - falls * enter_m <= top_m) & (enter_m >= 0.0), enter_m, np.inf)
    if eye_m > top_m:
        with np.errstate(divide="ignore"):
            tops_m = (eye_m - top_m) / falls
        met_m = np.where((tops_m > np.maximum(enter_m, 0.0)) & (tops_m < leave_m), tops_m, met_m)
    found_m[:, columns] = np.minimum(found_m[:, columns], met_m)
