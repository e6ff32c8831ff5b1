"""MAVLink's frames, masks and modes; pure functions.

The vehicle's frame is local NED: x north, y east, z down. The fleet's map is x east, y north: the headings differ by a
quarter, and the turns have opposite signs.

Source: https://mavlink.io/en/messages/common.html; the modes: ArduPilot's and PX4's documents of flight modes.
"""

from __future__ import annotations

import math
from typing import Final

from eal_actors.plugin import ArgumentError, wrapped_rad

PX4: Final = 12
GROUND_STATION: Final = 6
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

_PX4_MODES: Final = {
    "MANUAL": (1, 0),
    "POSCTL": (3, 0),
    "LOITER": (4, 3),
    "RTL": (4, 5),
    "LAND": (4, 6),
    "OFFBOARD": (6, 0),
}
_ROVER_MODES: Final = {"MANUAL": 0, "HOLD": 4, "AUTO": 10, "RTL": 11, "GUIDED": 15}
_COPTER_MODES: Final = {
    "STABILIZE": 0,
    "ALT_HOLD": 2,
    "AUTO": 3,
    "GUIDED": 4,
    "LOITER": 5,
    "RTL": 6,
    "LAND": 9,
    "BRAKE": 17,
}


def _custom_modes(autopilot: int, vehicle: str) -> dict[str, int]:
    """Return the modes of an autopilot by their names."""
    if autopilot == PX4:
        return {name: main << 16 | sub << 24 for name, (main, sub) in _PX4_MODES.items()}
    return _COPTER_MODES if vehicle == "copter" else _ROVER_MODES


def guided_mode(autopilot: int) -> str:
    """Return the mode in which an autopilot takes set-points."""
    return "OFFBOARD" if autopilot == PX4 else "GUIDED"


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
        main, sub = _PX4_MODES[name]
        return float(CUSTOM_MODE), float(main), float(sub)
    return float(CUSTOM_MODE), float(modes[name]), 0.0


def map_pose(north_m: float, east_m: float, heading_rad: float) -> tuple[float, float, float]:
    """Return x, y and yaw in the map of a pose in the vehicle's frame."""
    return east_m, north_m, wrapped_rad(math.pi / 2 - heading_rad)


def heading_rad(yaw_rad: float) -> float:
    """Return the heading in the vehicle's frame of a yaw in the map."""
    return wrapped_rad(math.pi / 2 - yaw_rad)
