"""The additions of the EvBot III's firmware to that of the EvBot II: turret, bumpers and battery."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, Protocol

from typing_extensions import override

from eal_actors.plugin import wrapped_rad

from ..evbot2.messages import Code, State, Verb
from ..evbot2.vehicle import Vehicle
from ..evbot2.wheels import Actuator
from .status import SenseStatus, TurretStatus

MAX_SWING_RAD: Final = math.radians(3600)
MAX_TURRET_RATE_RAD_S: Final = math.radians(180)
MIN_TURRET_RATE_RAD_S: Final = math.radians(0.5)

_U: Final = 1e6
_MOST: Final = (1 << 31) - 1


class TurretServo(Protocol):
    """The servo of a turret, with its own encoder and control loop."""

    @property
    def yaw_rad(self) -> float:
        """Its angle, to the left of straight ahead, unwrapped."""
        raise NotImplementedError

    @property
    def remaining_s(self) -> float:
        """The time until it rests; 0 at rest."""
        raise NotImplementedError

    def turn(self, angle_rad: float, rate_rad_s: float) -> None:
        """Begin to turn by an angle, positive to the left, in place of the running turn."""

    def stop(self) -> None:
        """Stop at once."""


class TurretVehicle(Vehicle, Protocol):
    """A vehicle with a turret, bumpers and a battery."""

    @property
    def turret(self) -> TurretServo | None:
        """The turret."""
        raise NotImplementedError

    def bumps(self) -> tuple[bool, bool]:
        """Return whether the left and the right bumper are pressed."""
        raise NotImplementedError

    def battery(self) -> Any:
        """Return the battery, with voltage_v, current_a, charge_ah, capacity_ah and temperature_c."""
        raise NotImplementedError


class TurretController(Actuator):
    """Controls the turret."""

    def __init__(self, servo: TurretServo) -> None:
        super().__init__()
        self._servo = servo

    @override
    def accept(self, verb: Verb, numbers: Sequence[int], tag: int, now_s: float) -> Code:
        if verb is Verb.REST:
            self.stop(State.STOPPED)
            return Code.OK
        angle_rad, rate_rad_s = (number / _U for number in numbers)
        in_range = abs(angle_rad) <= MAX_SWING_RAD + 1 / _U
        if not in_range or not MIN_TURRET_RATE_RAD_S <= rate_rad_s <= MAX_TURRET_RATE_RAD_S + 1 / _U:
            return Code.RANGE
        if verb is Verb.AIM:
            angle_rad = wrapped_rad(angle_rad - self._servo.yaw_rad)
        self._order, self._state = tag, State.MOVING
        self._servo.turn(angle_rad, rate_rad_s)
        return Code.OK

    @override
    def tick(self, now_s: float) -> None:
        if self.is_busy and not self._servo.remaining_s:
            self._state = State.DONE

    @override
    def stop(self, state: State) -> None:
        self._servo.stop()
        if self._state is State.MOVING:
            self._state = state

    @override
    def status(self) -> TurretStatus:
        return TurretStatus(self._order, self._state, round(wrapped_rad(self._servo.yaw_rad) * _U))


def senses(vehicle: TurretVehicle) -> SenseStatus:
    """Return the state of bumpers and battery."""
    left, right = vehicle.bumps()
    battery = vehicle.battery()
    figures = (battery.voltage_v, battery.current_a, battery.charge_ah, battery.capacity_ah, battery.temperature_c)
    return SenseStatus(left + 2 * right, *(max(-_MOST, min(_MOST, round(figure * 1000))) for figure in figures))
