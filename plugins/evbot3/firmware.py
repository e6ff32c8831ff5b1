"""What the EvBot III's firmware has besides that of the EvBot II: the turret, bumpers and a battery."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, Protocol

from ..evbot2.body import Body
from ..evbot2.messages import Code, State, Verb
from .status import SenseStatus, TurretStatus

MAX_SWING_RAD: Final = math.radians(3600)
MAX_TURRET_RATE_RAD_S: Final = math.radians(180)
MIN_TURRET_RATE_RAD_S: Final = math.radians(0.5)

_U: Final = 1e6
_MOST: Final = (1 << 31) - 1


class TurretServo(Protocol):
    """The motor of a turret, with an encoder and a loop of its own."""

    @property
    def yaw_rad(self) -> float:
        """Its angle, to the left of straight ahead, unwrapped."""
        ...

    @property
    def remaining_s(self) -> float:
        """The time until it rests; 0 when it does."""
        ...

    def turn(self, angle_rad: float, rate_rad_s: float) -> None:
        """Begin to turn by an angle, to the left where it is positive, in place of what it did."""
        ...

    def stop(self) -> None:
        """Stop at once."""
        ...


class BatteryReading(Protocol):
    """What a battery shows."""

    @property
    def voltage_v(self) -> float:
        """Voltage."""
        ...

    @property
    def current_a(self) -> float:
        """Current, negative while it is drained."""
        ...

    @property
    def charge_ah(self) -> float:
        """What is left."""
        ...

    @property
    def capacity_ah(self) -> float:
        """What it holds when it is full."""
        ...

    @property
    def temperature_c(self) -> float:
        """Temperature."""
        ...


class TurretBody(Body, Protocol):
    """A body with a turret, bumpers and a battery."""

    @property
    def turret(self) -> TurretServo | None:
        """The turret."""
        ...

    def bumps(self) -> tuple[bool, bool]:
        """Return whether the left and the right bumper are pressed."""
        ...

    def battery(self) -> BatteryReading:
        """Return what the battery shows."""
        ...


class Turret:
    """The turret: an Actuator.

    Args:
        servo: what turns it.
    """

    def __init__(self, servo: TurretServo) -> None:
        self._servo = servo
        self._order = 0
        self._state = State.IDLE

    @property
    def is_busy(self) -> bool:
        """See Actuator."""
        return self._state is State.MOVING

    def accept(self, verb: Verb, numbers: Sequence[int], tag: int, now_s: float) -> Code:  # noqa: ARG002  # no timing
        """See Actuator."""
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

    def tick(self, now_s: float) -> None:  # noqa: ARG002  # the servo has a clock of its own
        """See Actuator."""
        if self.is_busy and not self._servo.remaining_s:
            self._state = State.DONE

    def stop(self, state: State) -> None:
        """See Actuator."""
        self._servo.stop()
        if self._state is State.MOVING:
            self._state = state

    def status(self) -> TurretStatus:
        """See Actuator."""
        return TurretStatus(self._order, self._state, round(wrapped_rad(self._servo.yaw_rad) * _U))


def senses(body: TurretBody) -> SenseStatus:
    """Return what bumpers and battery show."""
    left, right = body.bumps()
    battery = body.battery()
    figures = (battery.voltage_v, battery.current_a, battery.charge_ah, battery.capacity_ah, battery.temperature_c)
    return SenseStatus(left + 2 * right, *(max(-_MOST, min(_MOST, round(figure * 1000))) for figure in figures))


def wrapped_rad(angle_rad: float) -> float:
    """Return the same direction in (-pi, pi]."""
    return math.pi - (math.pi - angle_rad) % math.tau
