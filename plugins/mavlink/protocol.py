"""MAVLink's frames, masks and modes; pure functions.

The vehicle's frame is local NED: x north, y east, z down. The fleet's map is x east, y north: the headings differ by a
quarter, and the turns have opposite signs.

Source: https://mavlink.io/en/messages/common.html; the modes are pymavlink's tables.
"""

from __future__ import annotations

import math
from typing import Final

from pymavlink import mavutil

from eal_actors.plugin import ArgumentError, wrapped_rad

PX4: Final = 12
OFFBOARD: Final = "OFFBOARD"
"""PX4's mode that takes set-points."""
GROUND_STATION: Final = 6
AUTOPILOT: Final = 1
"""The component of an autopilot; a gimbal and a computer on board have others in the vehicle's system."""
ARMED: Final = 128
CUSTOM_MODE: Final = 1
LOCAL_NED: Final = 1
BODY_NED: Final = 8
VELOCITY_MASK: Final = 0b0000_0101_1100_0111
"""Of SET_POSITION_TARGET_LOCAL_NED: velocities and the yaw rate count."""
POSITION_MASK: Final = 0b0000_1101_1111_1000
"""The position counts."""
POSE_MASK: Final = 0b0000_1001_1111_1000
"""The position and the yaw count."""


_SYSTEM_AT: Final = {0xFD: 5, 0xFE: 3}
"""Position of the system in a frame, by its first byte: MAVLink 2 and 1."""


def begins_frame_of(data: bytes, system: int) -> bool:
    """Return whether bytes begin with a frame of a system."""
    at = _SYSTEM_AT.get(data[0]) if data else None
    return at is not None and len(data) > at and data[at] == system


def _custom_modes(autopilot: int, vehicle: str) -> dict[str, int]:
    """Return the modes of an autopilot by their names."""
    if autopilot == PX4:
        return {name: main << 16 | sub << 24 for name, (_, main, sub) in mavutil.px4_map.items()}
    numbers = mavutil.mode_mapping_acm if vehicle == "copter" else mavutil.mode_mapping_rover
    return {name: number for number, name in numbers.items()}


def guided_mode(autopilot: int) -> str:
    """Return the mode in which an autopilot takes set-points."""
    return OFFBOARD if autopilot == PX4 else "GUIDED"


def mode_name(autopilot: int, vehicle: str, custom_mode: int) -> str:
    """Return the name of a mode in a heartbeat."""
    names = {number: name for name, number in _custom_modes(autopilot, vehicle).items()}
    return names.get(custom_mode, f"mode {custom_mode}")


def mode_parameters(autopilot: int, vehicle: str, name: str) -> tuple[float, float, float]:
    """Return the parameters of MAV_CMD_DO_SET_MODE.

    Raises:
        ArgumentError: the autopilot has no such mode.
    """
    modes = _custom_modes(autopilot, vehicle)
    if name not in modes:
        raise ArgumentError(f"there is no mode {name!r}; the autopilot has {', '.join(sorted(modes))}")
    if autopilot == PX4:
        return float(CUSTOM_MODE), float(modes[name] >> 16 & 0xFF), float(modes[name] >> 24)
    return float(CUSTOM_MODE), float(modes[name]), 0.0


def map_pose(north_m: float, east_m: float, heading_rad: float) -> tuple[float, float, float]:
    """Return x, y and yaw in the map of a pose in the vehicle's frame."""
    return east_m, north_m, wrapped_rad(math.pi / 2 - heading_rad)


def heading_rad(yaw_rad: float) -> float:
    """Return the heading in the vehicle's frame of a yaw in the map."""
    return wrapped_rad(math.pi / 2 - yaw_rad)
