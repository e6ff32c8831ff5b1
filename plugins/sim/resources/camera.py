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
    setting,
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

    width: int = setting(_SIZE, "Width of the picture.")
    height: int = setting(_SIZE, "Height of the picture.")
    fov_deg: float = setting(
        ValueInfo(DataType.DOUBLE, "deg", 10, 150),
        "Field of view, from the left edge of the picture to the right edge.",
    )
    noise: float = setting(
        ValueInfo(DataType.DOUBLE, minimum=0, maximum=100, description="grey levels"),
        "Standard deviation of the noise of every colour value, in grey levels.",
    )
    exposure: float = setting(
        ValueInfo(DataType.DOUBLE, minimum=0, maximum=16, description="factor on the grey levels"),
        "Factor on the grey levels: 2 is twice as bright, clipped at white.",
    )

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        super().__init__(world, robot)
        self.width, self.height = 640, 480
        self.fov_deg = 60.0
        self.noise = 0.0
        self.exposure = 1.0
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
            seed = int(self._robot.sensor_generator.integers(2**63)) if self.noise else 0
        image = expose(render(scene, movers, eye), self.exposure, self.noise, seed)
        if self._robot.faults.camera_black:
            image = np.zeros_like(image)
        return EALData.of(image, frame_id=f"{self._robot.name}/camera", stamp_s=now_s)

    @request("intrinsics", ValueInfo(DataType.DOUBLE, "px", shape=(3, 3)))
    def intrinsics(self) -> EALData:
        """Return the camera matrix: from x right, y down, z ahead to pixels, the centre of the first one at 0, 0."""
        return EALData.of(self._lens().matrix, unit="px")

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
        return PinholeLens(self.width, self.height, self.fov_deg)


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
