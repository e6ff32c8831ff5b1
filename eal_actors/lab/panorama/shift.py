"""How far two frames are apart on the cylinder, and angles round it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

How = Literal["features", "gradients", "odometry only"]
"""What a frame was placed by."""

WINDOW_RAD: Final = math.radians(12)
"""So far odometry may be wrong about the turn between two frames."""
TILT_RAD: Final = math.radians(3)
"""So far one frame may look higher than another."""


@dataclass(frozen=True, slots=True)
class Shift:
    """How far the axis of a second frame is from that of a first one, as their pictures tell.

    Attributes:
        right_px: how far to the right, in pixels of the cylinder.
        down_px: how far down.
        how: what tells.
        sigma_px: about how far it may be off.
    """

    right_px: float
    down_px: float
    how: How
    sigma_px: float


def wrapped_rad(angle_rad: float) -> float:
    """Return an angle in [-pi, pi)."""
    return (angle_rad + math.pi) % (2 * math.pi) - math.pi
