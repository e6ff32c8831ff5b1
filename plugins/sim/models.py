"""The makes of robots that can be simulated: their sizes, speeds and errors.

The errors are what is left after a calibration: about 1 % of a distance and 2 % of an angle. An uncalibrated tracked
base turns about 17 % too little (a track factor of 1.2).
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal

MakeName = Literal["evbot2", "evbot3", "roomba"]


@dataclass(frozen=True, slots=True)
class WheelErrors:
    """How a robot's true motion differs from what its wheel encoders count.

    Attributes:
        k_left: travel of the left wheel per metre counted.
        k_right: travel of the right wheel per metre counted.
        track_factor: effective over nominal track: over 1 the robot turns too little (E_b of Borenstein and Feng).
        walk: each wheel's factor also wanders from 1 during a motion, by this standard deviation after 1 s.
    """

    k_left: float = 1.0
    k_right: float = 1.0
    track_factor: float = 1.0
    walk: float = 0.0


NO_ERRORS: Final = WheelErrors()


@dataclass(frozen=True, slots=True)
class Make:
    """A make of robot: a disc with two driven wheels or tracks, turning about its centre.

    Attributes:
        name: as the settings spell it.
        radius_m: of the disc.
        mass_kg: of the whole robot.
        track_m: nominal distance of the wheels.
        speed_m_s: speed at first.
        max_speed_m_s: greatest speed.
        turn_rate_deg_s: turn rate at first.
        max_turn_rate_deg_s: greatest turn rate.
        acceleration_m_s2: of each wheel, speeding up and slowing down.
        errors: of its wheels.
    """

    name: MakeName
    radius_m: float
    mass_kg: float
    track_m: float
    speed_m_s: float
    max_speed_m_s: float
    turn_rate_deg_s: float
    max_turn_rate_deg_s: float
    acceleration_m_s2: float
    errors: WheelErrors


MAKES: Final = MappingProxyType(
    {
        make.name: make
        for make in (
            Make("evbot2", 0.18, 4.0, 0.24, 0.25, 0.4, 60.0, 120.0, 0.5, WheelErrors(1.003, 0.998, 1.02, 0.004)),
            Make("evbot3", 0.20, 6.0, 0.30, 0.35, 0.6, 90.0, 150.0, 0.8, WheelErrors(1.001, 0.999, 0.985, 0.002)),
            Make("roomba", 0.17, 2.9, 0.258, 0.30, 0.5, 90.0, 180.0, 0.8, WheelErrors(0.998, 1.002, 1.012, 0.003)),
        )
    }
)
