"""RobotShape: how large a robot is, and where its camera looks, for the page's map."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.device.data import EALData
from eal_actors.device.info import ResourceInfo
from eal_actors.operate.dashboard.teleop import DRIVE_RESOURCE

_RADIUS: Final = "radius_m"
_FOV: Final = "fov_deg"
_TURRET: Final = "Turret"
"""The resource whose value is the direction of the camera, in radians to the left of straight ahead."""


class RobotShape:
    """Asks a robot for its radius and the view of its first camera. A question that is open is not asked again.

    Thread: the poller's; nothing waits.
    """

    def __init__(self, robot: RobotHandle) -> None:
        self._robot = robot
        self._camera: str | None = None
        self._has_turret = False
        self._open: dict[str, Future[EALData]] = {}
        self._numbers: dict[str, float] = {}

    def describe(self, infos: Mapping[str, ResourceInfo]) -> None:
        """Record the robot's resources, and request the values that are read once."""
        cameras = [name for name, info in infos.items() if info.is_camera and _has_config(info, _FOV)]
        self._camera = cameras[0] if cameras else None
        self._has_turret = _TURRET in infos and _TURRET in self._robot
        self._numbers.clear()
        self._open.clear()
        base = infos.get(DRIVE_RESOURCE)
        if base is not None and _has_config(base, _RADIUS):
            self._open[_RADIUS] = self._robot[DRIVE_RESOURCE].get_config(_RADIUS)
        if self._camera is not None:
            self._open[_FOV] = self._robot[self._camera].get_config(_FOV)

    def ask(self) -> None:
        """Ask for the direction of the turret."""
        if self._has_turret and self._camera is not None and _TURRET not in self._open:
            self._open[_TURRET] = self._robot[_TURRET].get_value()

    def to_dict(self) -> dict[str, Any]:
        """Return `radius_m` and `view` as the page expects them; None where it is not known."""
        for name, answer in list(self._open.items()):
            if answer.done():
                del self._open[name]
                value = answer.get().value if answer.exception() is None else None
                if isinstance(value, int | float):
                    self._numbers[name] = round(float(value), 3)
        fov_deg, yaw_rad = self._numbers.get(_FOV), self._numbers.get(_TURRET, 0.0)
        is_known = fov_deg is not None and (not self._has_turret or _TURRET in self._numbers)
        view = {"fov_deg": fov_deg, "yaw_rad": yaw_rad} if is_known else None
        return {"radius_m": self._numbers.get(_RADIUS), "view": view}


def _has_config(info: ResourceInfo, name: str) -> bool:
    return any(config.name == name for config in info.configs)
