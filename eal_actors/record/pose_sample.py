"""Where a robot was, and when."""

from __future__ import annotations

from typing import NamedTuple


class PoseSample(NamedTuple):
    """A pose in the world frame, and when it was so, in seconds: of the fleet's clock, or since a run's start."""

    time_s: float
    x_m: float
    y_m: float
    yaw_rad: float
