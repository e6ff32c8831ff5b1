"""The camera of a simulated robot."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from eal_actors.plugin import (
    ArgumentError,
    DataType,
    EALData,
    ResourceType,
    UnavailableError,
    ValueInfo,
    config,
    config_setter,
    request,
)

from ..camera.eye import Eye, PinholeLens
from ..robot import SimRobot
from ..world import SimWorld
from .robot_resource import RobotResource

_FROM_WALL_M: Final = 0.002  # keeps a camera at the rim of a robot that pushes a wall inside the room
_SIZE: Final = ValueInfo(DataType.INT, "px", 16, 4096)


class Camera(RobotResource):
    """Camera that faces ahead, or with the turret: pictures of the room, its objects and other robots."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.CHAR, shape=(None, None, 3), description="RGB, rows from the top")

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        super().__init__(world, robot)
        self._width, self._height = 640, 480
        self._fov_deg = 60.0
        self._noise = 0.0
        self._exposure = 1.0
        self._offset_m = 0.0

    def get_value(self) -> EALData:
        """Return the current picture, shape (height, width, 3); the first picture of a world takes longest.

        Raises:
            UnavailableError: OpenCV is not installed, or the robot has no place in the world.
        """
        try:
            from ..camera.render import expose, render
            from ..camera.shared import movers_of, scene_of
        except ImportError as error:
            raise UnavailableError(f"pictures need OpenCV ({error}): pip install 'eal-actors[vision]'") from None
        scene = scene_of(self._world)
        with self._world.lock:
            now_s = self._world.catch_up()
            eye = mounted_eye(self._world, self._robot, self._lens(), self._offset_m)
            movers = movers_of(self._world, self._robot)
            seed = int(self._robot.sensor_generator.integers(2**63)) if self._noise else 0
        image = expose(render(scene, movers, eye), self._exposure, self._noise, seed)
        if self._robot.faults.camera_black:
            image = np.zeros_like(image)
        return EALData.of(image, frame_id=f"{self._robot.name}/camera", stamp_s=now_s)

    @request("intrinsics", ValueInfo(DataType.DOUBLE, "px", shape=(3, 3)))
    def intrinsics(self) -> EALData:
        """Return the camera matrix: from x right, y down, z ahead to pixels, the centre of the first one at 0, 0."""
        return EALData.of(self._lens().matrix, unit="px")

    @config("width", _SIZE)
    def width(self) -> int:
        """Width of the picture."""
        return self._width

    @config_setter("width")
    def set_width(self, width: int) -> None:
        """Set the width of later pictures."""
        self._width = width

    @config("height", _SIZE)
    def height(self) -> int:
        """Height of the picture."""
        return self._height

    @config_setter("height")
    def set_height(self, height: int) -> None:
        """Set the height of later pictures."""
        self._height = height

    @config("fov_deg", ValueInfo(DataType.DOUBLE, "deg", 10, 150))
    def fov_deg(self) -> float:
        """Field of view, from the left edge of the picture to the right edge."""
        return self._fov_deg

    @config_setter("fov_deg")
    def set_fov_deg(self, fov_deg: float) -> None:
        """Set the field of view of later pictures."""
        self._fov_deg = float(fov_deg)

    @config("noise", ValueInfo(DataType.DOUBLE, minimum=0, maximum=100, description="grey levels"))
    def noise(self) -> float:
        """Standard deviation of the noise of every colour value, in grey levels."""
        return self._noise

    @config_setter("noise")
    def set_noise(self, noise: float) -> None:
        """Set the noise of later pictures."""
        self._noise = float(noise)

    @config("exposure", ValueInfo(DataType.DOUBLE, minimum=0, maximum=16, description="factor on the grey levels"))
    def exposure(self) -> float:
        """Factor on the grey levels: 2 is twice as bright, clipped at white."""
        return self._exposure

    @config_setter("exposure")
    def set_exposure(self, exposure: float) -> None:
        """Set the exposure of later pictures."""
        self._exposure = float(exposure)

    @config("offset_m", ValueInfo(DataType.DOUBLE, "m", -1, 1))
    def offset_m(self) -> float:
        """Distance of the camera ahead of its axis of rotation."""
        return self._offset_m

    @config_setter("offset_m")
    def set_offset_m(self, offset_m: float) -> None:
        """Set the distance of the camera ahead of its axis."""
        most_m = self._robot.make.radius_m
        if abs(offset_m) > most_m:
            raise ArgumentError(
                f"configuration key 'offset_m': the {self._robot.make.name} has a radius of {most_m:g} m, "
                f"{offset_m:g} m is outside"
            )
        self._offset_m = float(offset_m)

    def _lens(self) -> PinholeLens:
        return PinholeLens(self._width, self._height, self._fov_deg)


def mounted_eye(world: SimWorld, robot: SimRobot, lens: PinholeLens, offset_m: float = 0.0) -> Eye:
    """Return the eye of a robot's camera, which turns with its turret. Thread: holds the world's `lock`.

    Raises:
        UnavailableError: the robot has no place in the world.
    """
    x_m, y_m, yaw_rad = robot.pose
    yaw_rad += robot.turret_yaw_rad
    x_m, y_m = x_m + offset_m * math.cos(yaw_rad), y_m + offset_m * math.sin(yaw_rad)
    most_x_m, most_y_m = (size_m / 2 - _FROM_WALL_M for size_m in world.model.size_m)
    x_m, y_m = min(max(x_m, -most_x_m), most_x_m), min(max(y_m, -most_y_m), most_y_m)
    return Eye(x_m, y_m, robot.make.camera_height_m, yaw_rad, lens)
