"""The drivetrain of a robot with two driven wheels: its limits, and the calibration of its wheels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from pydantic import Field

from eal_actors.kernel.strict_model import StrictModel


class WheelCalibration(StrictModel):
    """The deviation of a robot's wheels from their nominal sizes, in the terms of Borenstein and Feng.

    A base commands its wheels and computes its odometry by it, so that distances and angles come out true.
    With both factors at 1, nothing changes, not even by a rounding.
    """

    track_factor: float = Field(default=1.0, ge=0.5, le=2.0)
    """E_b: effective over nominal distance of the wheels; over 1 the robot turns too little."""
    wheel_ratio: float = Field(default=1.0, ge=0.9, le=1.1)
    """E_d: diameter of the right wheel over the left one's; over 1 the robot drifts to the left."""

    @property
    def left_factor(self) -> float:
        """c_L: travel of the left wheel per metre counted."""
        return 2.0 / (self.wheel_ratio + 1.0)

    @property
    def right_factor(self) -> float:
        """c_R: travel of the right wheel per metre counted; the mean of both is 1."""
        return 2.0 / (1.0 / self.wheel_ratio + 1.0)

    def counted(self, ahead: float, arc: float) -> tuple[float, float]:
        """Return the counts of the left and the right wheel for a motion.

        Args:
            ahead: distance or speed of the robot's centre.
            arc: the angle to the left, or its rate, times half the nominal distance of the wheels; in the unit of
                `ahead`.
        """
        arm = arc * self.track_factor
        return (ahead - arm) / self.left_factor, (ahead + arm) / self.right_factor

    def travelled(self, left: float, right: float) -> tuple[float, float]:
        """Return the motion for the counts of the wheels: distance ahead, and arc to the left. Inverts `counted`."""
        left, right = left * self.left_factor, right * self.right_factor
        return (left + right) / 2, (right - left) / 2 / self.track_factor


NOMINAL: Final = WheelCalibration()
"""The calibration of wheels of exactly their nominal sizes."""


@dataclass(frozen=True, slots=True)
class Drivetrain:
    """The abilities of the wheels and motors of a type of robot.

    Attributes:
        name: the type's name, for messages.
        track_m: nominal distance of its wheels.
        speed_m_s: default speed.
        max_speed_m_s: greatest speed, of each wheel too.
        turn_rate_deg_s: default turn rate.
        max_turn_rate_deg_s: greatest turn rate.
        acceleration_m_s2: of each wheel, for motions to a pose.
        radius_m: of the smallest disc about the robot's centre that it fits in.
    """

    name: str
    track_m: float
    speed_m_s: float
    max_speed_m_s: float
    turn_rate_deg_s: float
    max_turn_rate_deg_s: float
    acceleration_m_s2: float = 0.4
    radius_m: float = 0.2
