"""The resources of a simulated robot."""

from __future__ import annotations

from .base import Base
from .battery import Battery
from .camera import Camera
from .faults import Faults
from .odometry import Odometry
from .pose import Pose
from .roomba import Buttons, Leds, Song
from .sensing import Beacons, Bump, Cliff, Compass, Light, Range, Wall, WheelDrop
from .turret import Turret

__all__ = [
    "Base",
    "Battery",
    "Beacons",
    "Bump",
    "Buttons",
    "Camera",
    "Cliff",
    "Compass",
    "Faults",
    "Leds",
    "Light",
    "Odometry",
    "Pose",
    "Range",
    "Song",
    "Turret",
    "Wall",
    "WheelDrop",
]
