"""The resources of a simulated robot."""

from __future__ import annotations

from .actuators import Base, Turret
from .camera import Camera
from .depth_camera import DepthCamera
from .faults import Faults
from .imu import Imu
from .lidar import Lidar
from .pose import Odometry, Pose, TruePose
from .roomba import Buttons, Leds, Song
from .sensing import Battery, Beacons, Bump, Cliff, Compass, Light, Range, Wall, WheelDrop

__all__ = [
    "Base",
    "Battery",
    "Beacons",
    "Bump",
    "Buttons",
    "Camera",
    "Cliff",
    "Compass",
    "DepthCamera",
    "Faults",
    "Imu",
    "Leds",
    "Lidar",
    "Light",
    "Odometry",
    "Pose",
    "Range",
    "Song",
    "TruePose",
    "Turret",
    "Wall",
    "WheelDrop",
]
