"""The camera of a simulated robot as a device, for a driver's emulator: real pixels from the robot's pose."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from eal_actors.plugin import PluginContext

from .robot import SimRobot
from .world import SimWorld

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .camera.eye import PinholeLens

_SIZE: Final = 640, 480
_FOV_DEG: Final = 60.0
_NOISE: Final = 1.0
"""Grey levels: a driver takes a source of identical pictures for a frozen one."""


class SimulatedRobotCamera:
    """A camera that a robot of the world carries. Thread: any.

    Args:
        offset_m: distance of the camera ahead of the robot's axis.
    """

    def __init__(self, world: SimWorld, robot: SimRobot, lens: PinholeLens, offset_m: float) -> None:
        self._world = world
        self._robot = robot
        self._lens = lens
        self._offset_m = offset_m

    def instant_s(self) -> float:
        """Return the time that a picture of now would have."""
        with self._world.lock:
            return self._world.catch_up()

    def frame(self) -> tuple[NDArray[np.uint8], float]:
        """Return the picture of now and its time; the first one of a world takes longest.

        Returns:
            Blue, green and red, shape (height, width, 3), and seconds of the fleet's clock.
        """
        from .camera.render import expose, render
        from .camera.shared import movers_of, scene_of
        from .resources.camera import mounted_eye

        scene = scene_of(self._world)
        with self._world.lock:
            now_s = self._world.catch_up()
            eye = mounted_eye(self._world, self._robot, self._lens, self._offset_m)
            movers = movers_of(self._world, self._robot)
        picture = expose(render(scene, movers, eye), 1.0, _NOISE, round(now_s * 1e6))
        return picture[:, :, ::-1].copy(), now_s


def carried_camera(context: PluginContext, world: SimWorld, robot: SimRobot) -> SimulatedRobotCamera:
    """Return the camera of a robot, with the lens of the driver's settings where they name it. Needs OpenCV."""
    from .camera.eye import PinholeLens

    settings: Mapping[str, Any] = context.settings if isinstance(context.settings, Mapping) else {}
    width, height = settings.get("width") or _SIZE[0], settings.get("height") or _SIZE[1]
    lens = PinholeLens(width, height, settings.get("fov_deg") or _FOV_DEG)
    return SimulatedRobotCamera(world, robot, lens, settings.get("offset_m") or 0.0)
