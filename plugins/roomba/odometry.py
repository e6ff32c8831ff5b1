"""Dead reckoning: a pose from what the wheels have travelled."""

from __future__ import annotations

import math

from eal_actors.plugin import wrapped_rad


class DeadReckoning:
    """A pose in the plane, x and y in metres and yaw in radians counter-clockwise, from the wheels' travels."""

    def __init__(self, wheelbase_m: float) -> None:
        self._wheelbase_m = wheelbase_m
        self._x_m = self._y_m = self._yaw_rad = 0.0

    @property
    def pose(self) -> tuple[float, float, float]:
        """The pose: x in m, y in m, yaw in rad, in (-pi, pi]."""
        return self._x_m, self._y_m, wrapped_rad(self._yaw_rad)

    def place(self, x_m: float, y_m: float, yaw_rad: float) -> None:
        """Set the pose."""
        self._x_m, self._y_m, self._yaw_rad = x_m, y_m, yaw_rad

    def add(self, left_m: float, right_m: float) -> None:
        """Advance by the wheels' travels, along their arc."""
        turn_rad = (right_m - left_m) / self._wheelbase_m
        chord_m = (left_m + right_m) / 2 * (math.sin(turn_rad / 2) / (turn_rad / 2) if turn_rad else 1.0)
        heading_rad = self._yaw_rad + turn_rad / 2
        self._x_m += chord_m * math.cos(heading_rad)
        self._y_m += chord_m * math.sin(heading_rad)
        self._yaw_rad += turn_rad
