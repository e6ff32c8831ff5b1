"""What a driver knows of its Roomba at a time, and what it tells the wheels: the same for every kind of Roomba."""

from __future__ import annotations

from dataclasses import dataclass

from .groups import Contacts, PowerGroup


@dataclass(frozen=True, slots=True)
class RoombaReading:
    """What the sensors said at one time.

    Attributes:
        stamp_s: a time at which it was not yet measured, in seconds of the fleet's clock: it is no older.
        contacts: what the Roomba touches and sees around itself.
        power: its battery.
        pressed: the buttons that are pressed.
        left_m: the left wheel's travel in all.
        right_m: the right wheel's travel in all.
        stands: whether neither wheel has turned since the reading before it.
    """

    stamp_s: float
    contacts: Contacts
    power: PowerGroup
    pressed: frozenset[str]
    left_m: float
    right_m: float
    stands: bool


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
        """Whether it leads to where the cliff sensors look."""
        return self.left_m_s + self.right_m_s > 0
