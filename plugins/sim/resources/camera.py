"""The camera of a simulated robot."""

from __future__ import annotations

from eal_actors.plugin import DataType, EALData, ResourceType, ValueInfo, config

from ..sensors import CAMERA_HEIGHT_PX, CAMERA_WIDTH_PX, draw_test_card
from .on_robot import OnRobot


class Camera(OnRobot):
    """Test card showing the heading; not a view of the world (the perspective camera is not built yet)."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.CHAR, shape=(CAMERA_HEIGHT_PX, CAMERA_WIDTH_PX, 3), description="RGB, rows from the top")

    def get_value(self) -> EALData:
        """Return the test card for the present heading."""
        with self._world.caught_up() as now_s:
            _, _, yaw_rad = self._robot.pose
        return EALData.of(draw_test_card(yaw_rad), frame_id=f"{self._robot.name}/camera", stamp_s=now_s)

    @config("width", ValueInfo(DataType.INT, "px"))
    def width(self) -> int:
        """Width of the image."""
        return CAMERA_WIDTH_PX

    @config("height", ValueInfo(DataType.INT, "px"))
    def height(self) -> int:
        """Height of the image."""
        return CAMERA_HEIGHT_PX
