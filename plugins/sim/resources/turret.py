"""The turret of a simulated robot."""

from __future__ import annotations

import math

from eal_actors.plugin import (
    Activity,
    DataType,
    EALData,
    ResourceType,
    UnsupportedError,
    ValueInfo,
    command,
    config,
    config_setter,
)

from ..models import MAKES
from ..robot import SimRobot
from ..sensors import wrapped_rad
from ..world import SimWorld
from .on_robot import OnRobot

_ANGLE = ValueInfo(DataType.DOUBLE, "deg", 0, 3600)
_TO_ANGLE = ValueInfo(DataType.DOUBLE, "deg", -360, 360)
_TURN_RATE = ValueInfo(
    DataType.DOUBLE, "deg/s", 1, max(make.turret.max_turn_rate_deg_s for make in MAKES.values() if make.turret)
)


class Turret(OnRobot):
    """Turns on the robot; get_status: 0 rests, 1 turns; get_value: its angle in rad, to the left of straight ahead.

    Raises:
        UnsupportedError: the make has no turret.
    """

    types = ResourceType.ACTUATOR
    value = ValueInfo(DataType.DOUBLE, "rad")

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        super().__init__(world, robot)
        if robot.turret is None:
            raise UnsupportedError(f"robot {robot.name!r} is an {robot.make.name}, which has no turret")
        self._turret = robot.turret
        self._turn_rate_deg_s = robot.turret.model.turn_rate_deg_s

    def get_status(self) -> int:
        """Return 0 while it rests, 1 while it turns."""
        with self._world.caught_up():
            return 1 if self._turret.remaining_s else 0

    def get_value(self) -> EALData:
        """Return its angle relative to the robot, in (-pi, pi]."""
        with self._world.caught_up() as now_s:
            yaw_rad = self._turret.yaw_rad
        return EALData.of(wrapped_rad(yaw_rad), unit="rad", frame_id=f"{self._robot.name}/base", stamp_s=now_s)

    def halt(self) -> None:
        """Stop at once."""
        with self._world.caught_up():
            self._turret.stop()

    @command("l<degrees>", _ANGLE)
    def left_by(self, degrees: float) -> Activity:
        """Turn left by an angle."""
        return self._turn(math.radians(degrees))

    @command("r<degrees>", _ANGLE)
    def right_by(self, degrees: float) -> Activity:
        """Turn right by an angle."""
        return self._turn(-math.radians(degrees))

    @command("t<degrees>", _TO_ANGLE)
    def turn_to(self, degrees: float) -> Activity:
        """Turn to an angle to the left of straight ahead, the shorter way round."""
        with self._world.caught_up():
            angle_rad = wrapped_rad(math.radians(degrees) - self._turret.yaw_rad)
        return self._turn(angle_rad)

    @command("s", urgent=True)
    def stop(self) -> int:
        """Stop at once."""
        self.halt()
        return 1

    @config("turn_rate_deg_s", _TURN_RATE)
    def turn_rate_deg_s(self) -> float:
        """Speed of turning."""
        return self._turn_rate_deg_s

    @config_setter("turn_rate_deg_s")
    def set_turn_rate_deg_s(self, turn_rate_deg_s: float) -> None:
        """Set the turn rate of later commands."""
        self._turn_rate_deg_s = float(turn_rate_deg_s)

    def _turn(self, angle_rad: float) -> Activity:
        with self._world.caught_up():
            self._turret.turn(angle_rad, math.radians(self._turn_rate_deg_s))
        try:
            while remaining_s := self._remaining_s():
                yield remaining_s
            return 1
        finally:
            with self._world.caught_up():
                self._turret.stop()

    def _remaining_s(self) -> float:
        with self._world.caught_up():
            return self._turret.remaining_s
