"""Readings and wheel commands, the same for both protocols."""

from __future__ import annotations

from dataclasses import dataclass

from .groups import Contacts, PowerGroup


@dataclass(frozen=True, slots=True)
class RoombaReading:
    """A reading of all sensors.

    Attributes:
        stamp_s: a lower bound of the time of measurement, in seconds of the fleet's clock.
        stands: whether neither wheel has turned for a while.
        pose: by dead reckoning from the start: x in m, y in m, yaw in rad.
    """

    stamp_s: float
    contacts: Contacts
    power: PowerGroup
    pressed: frozenset[str]
    left_m: float
    right_m: float
    stands: bool
    pose: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class WheelCommand:
    """A command to the wheels.

    Attributes:
        data: its bytes.
        left_m_s: the left wheel's speed that it means.
        right_m_s: the right wheel's.
    """

    data: bytes
    left_m_s: float
    right_m_s: float

    @property
    def goes_forward(self) -> bool:
        """Whether it moves towards the side of the cliff sensors."""
        return self.left_m_s + self.right_m_s > 0
