"""The measurements of a simulated robot's sensors: geometry of the current world, without memory."""

from __future__ import annotations

from .arrays import WorldArrays, shared
from .contact import dropped_wheels, is_wall_near, pressed_bumpers, seen_cliffs
from .field import compass_rad, light_lux, seen_beacons
from .geometry import Array, disc_span_m
from .rays import MAX_RANGE_M, RAY_ANGLES_RAD, RAYS, RayCaster, free_way_m

__all__ = [
    "MAX_RANGE_M",
    "RAYS",
    "RAY_ANGLES_RAD",
    "Array",
    "RayCaster",
    "WorldArrays",
    "compass_rad",
    "disc_span_m",
    "dropped_wheels",
    "free_way_m",
    "is_wall_near",
    "light_lux",
    "pressed_bumpers",
    "seen_beacons",
    "seen_cliffs",
    "shared",
]
