"""What a calibration is: two numbers, and how the counts of two wheels and the way of their robot follow from them."""

from __future__ import annotations

from pydantic import Field

from eal_actors.kernel.strict_model import StrictModel


class WheelCalibration(StrictModel):
    """How the wheels of a robot differ from their nominal sizes, in the terms of Borenstein and Feng.

    A base that knows it commands its wheels so that distances and angles come out true, and reckons its pose by it.
    With both at 1, nothing is changed, not even by a rounding.
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
        """Return what the left and the right wheel have to count.

        Args:
            ahead: how far the robot's centre goes, or how fast.
            arc: the angle that it turns to the left meanwhile, or the rate, times half the nominal distance of its
                wheels; in the unit of `ahead`.
        """
        arm = arc * self.track_factor
        return (ahead - arm) / self.left_factor, (ahead + arm) / self.right_factor

    def travelled(self, left: float, right: float) -> tuple[float, float]:
        """Return how far ahead, and by what arc to the left, the robot goes while the wheels count so much.

        It undoes `counted`.
        """
        left, right = left * self.left_factor, right * self.right_factor
        return (left + right) / 2, (right - left) / 2 / self.track_factor


NOMINAL = WheelCalibration()
"""Of wheels that are just as they should be."""
