"""The bodies that emulators drive: the interface, and a body on an endless floor."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Protocol

from typing_extensions import override

from .odometry import DeadReckoning

_ACCELERATION_M_S2: Final = 0.8


class RoombaBatteryReading(Protocol):
    """The state of a body's battery."""

    @property
    def voltage_v(self) -> float:
        """Voltage."""
        ...

    @property
    def current_a(self) -> float:
        """Current, negative while it is discharged."""
        ...

    @property
    def charge_ah(self) -> float:
        """Remaining charge."""
        ...

    @property
    def capacity_ah(self) -> float:
        """Charge when full."""
        ...

    @property
    def temperature_c(self) -> float:
        """Temperature."""
        ...


class RoombaBody(Protocol):
    """The body of a robot, as an emulator drives and reads it."""

    def drive(self, left_m_s: float, right_m_s: float) -> None:
        """Set the wheels' speeds until the next call; both 0 stops."""
        ...

    def travel_m(self) -> tuple[float, float]:
        """Return the totals of the left and the right wheel's encoder, forward positive."""
        ...

    def bumps(self) -> tuple[bool, bool]:
        """Return whether the left and the right bumper are pressed."""
        ...

    def strained(self) -> bool:
        """Return whether something blocks the motors."""
        ...

    def drops(self) -> tuple[bool, bool, bool]:
        """Return whether the left wheel, the right wheel and the caster have dropped."""
        ...

    def cliffs(self) -> tuple[bool, bool, bool, bool]:
        """Return whether there is no floor under left, front left, front right and right."""
        ...

    def wall(self) -> bool:
        """Return whether there is something close to the right-hand side."""
        ...

    def battery(self) -> RoombaBatteryReading:
        """Return the state of the battery."""
        ...


class OtherWheelbase:
    """A body with its wheels at another distance: the same speeds turn it at another rate.

    Args:
        factor: the distance of its wheels by that of the body.
    """

    def __init__(self, body: RoombaBody, factor: float) -> None:
        self._body = body
        self._factor = factor

    def drive(self, left_m_s: float, right_m_s: float) -> None:
        """Set the wheels' speeds until the next call; both 0 stops."""
        self._body.drive(*_spread(left_m_s, right_m_s, 1 / self._factor))

    def travel_m(self) -> tuple[float, float]:
        """Return the totals of the left and the right wheel's encoder, forward positive."""
        return _spread(*self._body.travel_m(), self._factor)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._body, name)


def _spread(left: float, right: float, factor: float) -> tuple[float, float]:
    """Multiply the difference of two values, and keep their mean."""
    mean, half = (left + right) / 2, (right - left) / 2 * factor
    return mean - half, mean + half


@dataclass
class ConstantBattery:
    """A battery in a constant state."""

    voltage_v: float = 16.1
    current_a: float = -0.3
    charge_ah: float = 1.35
    capacity_ah: float = 2.7
    temperature_c: float = 24.0


class FreeWheel:
    """A wheel that takes time to reach its speed."""

    def __init__(self) -> None:
        self.target_m_s = self.speed_m_s = self.travel_m = 0.0

    def advance(self, duration_s: float, acceleration_m_s2: float) -> None:
        """Advance by a duration, towards the target speed."""
        lack_m_s = self.target_m_s - self.speed_m_s
        ramp_s = min(duration_s, abs(lack_m_s) / acceleration_m_s2)
        before_m_s = self.speed_m_s
        self.speed_m_s += math.copysign(ramp_s * acceleration_m_s2, lack_m_s)
        if ramp_s < duration_s:
            self.speed_m_s = self.target_m_s
        self.travel_m += (before_m_s + self.speed_m_s) / 2 * ramp_s + self.speed_m_s * (duration_s - ramp_s)


class FreeDrive:
    """Two wheels on an endless floor. They are advanced lazily, on access.

    Args:
        now_s: returns the time in seconds.
        wheelbase_m: effective distance of the wheels.
        acceleration_m_s2: of each wheel.
    """

    brake_factor = 1.0
    """Wheels with target speeds of 0 decelerate by this factor faster than driven wheels accelerate."""

    def __init__(self, now_s: Callable[[], float], wheelbase_m: float, acceleration_m_s2: float) -> None:
        self.left, self.right = FreeWheel(), FreeWheel()
        self.is_stuck = False
        self._now_s = now_s
        self._acceleration_m_s2 = acceleration_m_s2
        self._at_s = now_s()
        self._odometer = DeadReckoning(wheelbase_m)

    @property
    def pose(self) -> tuple[float, float, float]:
        """The true pose: x in m, y in m, yaw in rad in (-pi, pi], from (0, 0, 0) at first."""
        self._catch_up()
        return self._odometer.pose

    @property
    def is_driven(self) -> bool:
        """Whether a wheel has a target speed."""
        return bool(self.left.target_m_s or self.right.target_m_s)

    def drive(self, left_m_s: float, right_m_s: float) -> None:
        """Set the wheels' speeds until the next call; both 0 stops."""
        self._catch_up()
        self.left.target_m_s, self.right.target_m_s = left_m_s, right_m_s

    def travel_m(self) -> tuple[float, float]:
        """Return the totals of the left and the right wheel's encoder, forward positive."""
        self._catch_up()
        return self.left.travel_m, self.right.travel_m

    def _catch_up(self) -> None:
        now_s, (left, right) = self._now_s(), (self.left, self.right)
        duration_s, self._at_s = now_s - self._at_s, now_s
        if self.is_stuck or duration_s <= 0:
            return
        before_m = left.travel_m, right.travel_m
        acceleration_m_s2 = self._acceleration_m_s2 * (1.0 if self.is_driven else self.brake_factor)
        for wheel in (left, right):
            wheel.advance(duration_s, acceleration_m_s2)
        self._odometer.add(left.travel_m - before_m[0], right.travel_m - before_m[1])


class FreeRoombaBody(FreeDrive, RoombaBody):
    """A body on an endless floor; a test sets its sensors.

    Args:
        now_s: returns the time in seconds.
        acceleration_m_s2: of each wheel.

    Attributes:
        bumped: the value of `bumps`; the others likewise.
    """

    def __init__(
        self, now_s: Callable[[], float], wheelbase_m: float, acceleration_m_s2: float = _ACCELERATION_M_S2
    ) -> None:
        super().__init__(now_s, wheelbase_m, acceleration_m_s2)
        self.bumped = (False, False)
        self.dropped = (False, False, False)
        self.over_cliffs = (False, False, False, False)
        self.by_wall = False
        self.charge = ConstantBattery()

    @override
    def bumps(self) -> tuple[bool, bool]:
        return self.bumped

    @override
    def strained(self) -> bool:
        return self.is_stuck and self.is_driven

    @override
    def drops(self) -> tuple[bool, bool, bool]:
        return self.dropped

    @override
    def cliffs(self) -> tuple[bool, bool, bool, bool]:
        return self.over_cliffs

    @override
    def wall(self) -> bool:
        return self.by_wall

    @override
    def battery(self) -> ConstantBattery:
        return self.charge
