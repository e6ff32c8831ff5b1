"""What a simulated robot senses of the world round it. Everything is geometry of the moment, without memory."""

from __future__ import annotations

from .contact import Cliffs, DroppedWheels, dropped_wheels, is_wall_near, pressed_bumpers, seen_cliffs
from .field import compass_rad, light_lux, seen_beacons
from .geometry import wrapped_rad
from .rays import MAX_RANGE_M, RAY_ANGLES_RAD, RAYS, ranges_m

__all__ = [
    "MAX_RANGE_M",
    "RAYS",
    "RAY_ANGLES_RAD",
    "Cliffs",
    "DroppedWheels",
    "compass_rad",
    "dropped_wheels",
    "is_wall_near",
    "light_lux",
    "pressed_bumpers",
    "ranges_m",
    "seen_beacons",
    "seen_cliffs",
    "wrapped_rad",
]
