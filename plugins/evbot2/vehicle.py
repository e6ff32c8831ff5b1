"""Vehicle models: the interface of a base's firmware to its wheels, and a vehicle on an endless floor."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from typing_extensions import override

from ..roomba.bodies import FreeDrive


class Vehicle(Protocol):
    """Two wheels or tracks with encoders. The simulation's vehicle also has `tick_s`, the length of a physics tick."""

    def drive(self, left_m_s: float, right_m_s: float) -> None:
        """Set the wheels' speeds until the next call; both 0 puts the brakes on."""

    def travel_m(self) -> tuple[float, float]:
        """Return the totals of the left and the right encoder, forward positive."""
        raise NotImplementedError

    def strained(self) -> bool:
        """Return whether something blocks the motors."""
        raise NotImplementedError


class FreeVehicle(FreeDrive, Vehicle):
    """A vehicle on an endless floor, with the kinematics of two tracks.

    Args:
        now_s: returns the time in seconds.
        track_m: nominal distance of the tracks.
        acceleration_m_s2: of each track.
        track_factor: effective over nominal distance: about 1.2 for real tracks, which skid; 1 is ideal.
    """

    brake_factor = 4.0

    def __init__(
        self, now_s: Callable[[], float], track_m: float, acceleration_m_s2: float, track_factor: float = 1.0
    ) -> None:
        super().__init__(now_s, track_m * track_factor, acceleration_m_s2)

    @override
    def strained(self) -> bool:
        return self.is_stuck and self.is_driven
