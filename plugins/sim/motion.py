"""Wheel motions: what the wheels are commanded to travel, what the encoders count, and what the robot travels.

A motion's duration is known in advance, because the encoders count the commanded travel, also where something holds the
robot. Everything here is pure and counts in physics ticks. No clock is read.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from typing_extensions import override

from eal_actors.plugin import MOST_SLIP_M, MOST_TURN_SLIP_M, WheelCalibration

from .arena import Pose2D
from .models import Make

if TYPE_CHECKING:
    from numpy.typing import NDArray

NOMINAL: Final = WheelCalibration()
"""The calibration of wheels without known errors."""

NORMALS_BLOCK: Final = 128
"""Normal numbers are drawn in blocks: drawn one by one, they cost more than the rest of a tick."""

ODOMETER_ROUNDING: Final = 1e-6
"""In encoder steps: a sum that falls short of a step by less counts as the step."""

STRAIGHT_RAD: Final = 1e-9
"""An arc of twice this angle or less is straight."""


class Trapezoid:
    """Trapezoidal motion profile: constant acceleration, cruise, constant deceleration; a triangle for short lengths.

    Args:
        length_m: travel, 0 or more.
        speed_m_s: cruising speed, over 0.
        acceleration_m_s2: over 0.
    """

    def __init__(self, length_m: float, speed_m_s: float, acceleration_m_s2: float) -> None:
        self.length_m = length_m
        self._acceleration = acceleration_m_s2
        self._peak = min(speed_m_s, math.sqrt(length_m * acceleration_m_s2))
        self._ramp_s = self._peak / acceleration_m_s2
        cruise_s = length_m / self._peak - self._ramp_s if length_m else 0.0
        self.duration_s = 2 * self._ramp_s + cruise_s

    @property
    def parts(self) -> tuple[float, float, float, float, float]:
        """The length, acceleration, greatest speed, duration of the acceleration, and duration."""
        return self.length_m, self._acceleration, self._peak, self._ramp_s, self.duration_s

    def travelled_m(self, time_s: float) -> float:
        """Return the travel at a time; exactly the length from the duration on."""
        left_s = self.duration_s - time_s
        if left_s <= 0:
            return self.length_m
        if time_s < self._ramp_s:
            return self._acceleration * time_s * time_s / 2
        if left_s < self._ramp_s:
            return self.length_m - self._acceleration * left_s * left_s / 2
        return self._peak * (time_s - self._ramp_s / 2)


class RegularMotion(NamedTuple):
    """The next ticks of a motion, for arrays of robots: a constant command, or the middle of a `Move`.

    Attributes:
        ticks: how many ticks it covers.
        is_move: 1 for a Move, 0 for a constant command.
        left: the left wheel's command in each tick, or its factor of a Move.
        right: of the right wheel.
        length_m: of a Move, as all that follow: length of its profile.
        acceleration_m_s2: of its profile.
        peak_m_s: greatest speed of its profile.
        ramp_s: duration of the acceleration.
        duration_s: of the whole.
        tick: ticks that are over.
        travelled_m: travel that is over.
    """

    ticks: float
    is_move: float
    left: float
    right: float
    length_m: float = 0.0
    acceleration_m_s2: float = 0.0
    peak_m_s: float = 0.0
    ramp_s: float = 0.0
    duration_s: float = 0.0
    tick: float = 0.0
    travelled_m: float = 0.0


class WheelMotion:
    """Commands to the two wheels, tick by tick.

    Attributes:
        noise_share: the share of a turn in place per metre of the left wheel; 0 for any other motion.
        most_slip_m: the motion ends where the wheels have turned so far in vain.
    """

    noise_share = 0.0
    most_slip_m = math.inf

    @property
    def remaining_s(self) -> float:
        """The time until the end, as far as it is known; 0 at the end, infinite without an end."""
        raise NotImplementedError

    @property
    def is_over(self) -> bool:
        """Whether the motion has ended."""
        raise NotImplementedError

    def step(self) -> tuple[float, float]:
        """Advance by one tick; return the commanded travel of the left and the right wheel in it, in metres."""
        raise NotImplementedError

    def regular(self) -> RegularMotion | None:
        """Return the next ticks if they are regular, else None."""
        raise NotImplementedError

    def skip(self, ticks: int, travelled_m: float) -> None:
        """Advance by regular ticks; the travel of a Move is then `travelled_m`."""
        raise NotImplementedError


class Move(WheelMotion):
    """A straight drive or a turn in place, over a known length.

    Args:
        left: factor from the profile to the left wheel; below 0 for backwards.
        right: factor from the profile to the right wheel.
        profile: the travel of each wheel.
    """

    def __init__(self, left: float, right: float, profile: Trapezoid, tick_s: float) -> None:
        self._left, self._right = left, right
        self._profile = profile
        self._tick_s = tick_s
        self._ticks = math.ceil(profile.duration_s / tick_s)
        self._tick = 0
        self._travelled_m = 0.0
        if left * right < 0 and profile.length_m > 0:
            self.noise_share = 1.0 / (left * profile.length_m)
        self.most_slip_m = MOST_TURN_SLIP_M if left * right < 0 else MOST_SLIP_M

    @classmethod
    def straight(
        cls, make: Make, distance_m: float, speed_m_s: float, tick_s: float, calibration: WheelCalibration = NOMINAL
    ) -> Move:
        """Return a straight drive; a negative distance is backwards."""
        left, right = calibration.counted(math.copysign(1.0, distance_m), 0.0)
        return cls(left, right, Trapezoid(abs(distance_m), speed_m_s, make.acceleration_m_s2), tick_s)

    @classmethod
    def turn(
        cls, make: Make, angle_rad: float, rate_rad_s: float, tick_s: float, calibration: WheelCalibration = NOMINAL
    ) -> Move:
        """Return a turn in place; a positive angle is to the left."""
        arm_m = make.track_m / 2
        left, right = calibration.counted(0.0, math.copysign(1.0, angle_rad))
        profile = Trapezoid(abs(angle_rad) * arm_m, rate_rad_s * arm_m, make.acceleration_m_s2)
        return cls(left, right, profile, tick_s)

    @property
    @override
    def remaining_s(self) -> float:
        return (self._ticks - self._tick) * self._tick_s

    @property
    def done_share(self) -> float:
        """The share of the length that is travelled, 0..1."""
        return self._travelled_m / self._profile.length_m if self._profile.length_m else 1.0

    @property
    @override
    def is_over(self) -> bool:
        return self._tick >= self._ticks

    @override
    def step(self) -> tuple[float, float]:
        self._tick += 1
        travelled_m = self._profile.travelled_m(self._tick * self._tick_s)
        if self._tick >= self._ticks:
            travelled_m = self._profile.length_m
        step_m, self._travelled_m = travelled_m - self._travelled_m, travelled_m
        return self._left * step_m, self._right * step_m

    @override
    def regular(self) -> RegularMotion | None:
        ticks = self._ticks - self._tick - 1  # the last one ends exactly at the length
        profile = self._profile.parts
        return RegularMotion(ticks, 1.0, self._left, self._right, *profile, self._tick, self._travelled_m)

    @override
    def skip(self, ticks: int, travelled_m: float) -> None:
        self._tick += ticks
        self._travelled_m = travelled_m


class SimWheels:
    """Two wheels with errors: counts the commanded travel and returns the true one.

    The random error of a wheel is white noise over its travel: after a distance d its variance is d times that of 1 m,
    whatever the speed, the length of a tick, and the number of motions.

    Args:
        make: supplies the wheel errors.
        generator: noise source; used only in ticks in which the robot is driven.

    Source: L. Kleeman, "Odometry Error Covariance Estimation for Two Wheel Robot Vehicles", Monash University,
    MECSE-95-1, 1995; K. S. Chong and L. Kleeman, "Accurate Odometry and Error Modelling for a Mobile Robot", IEEE
    International Conference on Robotics and Automation, 1997.

    Attributes:
        turned_m: total commanded travel in either direction, the mean of both wheels.
        shares: the share of its command that the left and the right wheel turn: below 1 for weak motors.
        stalls_ahead: something blocks the way: they do not turn forward.
    """

    def __init__(self, make: Make, generator: np.random.Generator) -> None:
        self._errors = make.errors
        self._turn_noise_rad = make.turn_noise_rad
        self._step_m = make.encoder_step_m
        self._track_m = make.track_m * make.errors.track_factor
        self.normals = NormalNumbers(generator)
        self._noise_rad_m = 0.0
        self._left_m = self._right_m = 0.0
        self.turned_m = 0.0
        self.shares = (1.0, 1.0)
        self.stalls_ahead = False

    def start(self, motion: WheelMotion) -> None:
        """Begin a motion: draw the noise of a turn in place."""
        self._noise_rad_m = 0.0
        if self._turn_noise_rad and motion.noise_share:
            self._noise_rad_m = self.normals.next() * self._turn_noise_rad * motion.noise_share

    def travel(self, left_m: float, right_m: float) -> tuple[float, float]:
        """Count one tick's command; return the robot's travel ahead in metres and its turn in radians."""
        self.turned_m += (abs(left_m) + abs(right_m)) / 2
        if self.stalls_ahead and left_m + right_m > abs(left_m - right_m):
            return 0.0, 0.0
        left_m, right_m = left_m * self.shares[0], right_m * self.shares[1]
        self._left_m += left_m
        self._right_m += right_m
        left, right = left_m * self._errors.k_left, right_m * self._errors.k_right
        if scatter_m := self._errors.scatter_m:
            left += scatter_m * math.sqrt(abs(left_m)) * self.normals.next()
            right += scatter_m * math.sqrt(abs(right_m)) * self.normals.next()
        return (left + right) / 2, (right - left) / self._track_m + left_m * self._noise_rad_m

    @property
    def counted_m(self) -> tuple[float, float]:
        """The encoder totals of the left and the right wheel, in whole steps."""
        step_m = self._step_m
        return (
            math.floor(self._left_m / step_m + ODOMETER_ROUNDING) * step_m,
            math.floor(self._right_m / step_m + ODOMETER_ROUNDING) * step_m,
        )

    def state(self) -> tuple[float, ...]:
        """Return its part of a FreeState."""
        errors = self._errors
        return (
            self._left_m,
            self._right_m,
            self.turned_m,
            *self.shares,
            errors.k_left,
            errors.k_right,
            errors.scatter_m,
            self._track_m,
            self._step_m,
            self._noise_rad_m,
        )

    def adopt(self, left_m: float, right_m: float, turned_m: float) -> None:
        """Set the totals."""
        self._left_m, self._right_m, self.turned_m = left_m, right_m, turned_m


class NormalNumbers:
    """The normal numbers of a generator, in one order however they are taken.

    Args:
        generator: used for this alone.
    """

    def __init__(self, generator: np.random.Generator) -> None:
        self._generator = generator
        self._left: list[float] = []
        """The next numbers, the very next one last."""

    def next(self) -> float:
        """Return the next number."""
        if not self._left:
            self._left = self.block()[::-1].tolist()
        return self._left.pop()

    def block(self) -> NDArray[np.float64]:
        """Return the block after everything drawn so far."""
        return self._generator.standard_normal(NORMALS_BLOCK)

    def take_all(self, more_than: int) -> list[float]:
        """Take the numbers that are drawn; draw more until they are more than a count."""
        taken, self._left = self._left[::-1], []
        while len(taken) <= more_than:
            taken += self.block().tolist()
        return taken

    def put_back(self, numbers: list[float]) -> None:
        """Put numbers back before all others."""
        self._left = self._left + numbers[::-1]


class WheelOdometer:
    """Dead reckoning from the encoders, the nominal track and the wheel calibration.

    Args:
        track_m: the nominal distance of the wheels.
        counted_m: the encoder totals at the start.

    Attributes:
        pose: x_m, y_m, yaw_rad, from (0, 0, 0) at first; yaw unwrapped.
    """

    def __init__(self, track_m: float, counted_m: tuple[float, float]) -> None:
        self.pose = (0.0, 0.0, 0.0)
        self._track_m = track_m
        self._counted_m = counted_m

    def follow(self, counted_m: tuple[float, float], calibration: WheelCalibration = NOMINAL) -> None:
        """Update the pose from new encoder totals."""
        before_m = self._counted_m
        self._counted_m = counted_m
        ahead_m, arc_m = calibration.travelled(counted_m[0] - before_m[0], counted_m[1] - before_m[1])
        self.pose = moved(self.pose, ahead_m, arc_m / (self._track_m / 2))

    def state(self, calibration: WheelCalibration) -> tuple[float, ...]:
        """Return its part of a FreeState."""
        factors = calibration.left_factor, calibration.right_factor, calibration.track_factor
        return *self.pose, *self._counted_m, *factors, self._track_m / 2

    def adopt(self, x_m: float, y_m: float, yaw_rad: float, left_m: float, right_m: float) -> None:
        """Set the pose, and the encoder totals that it has followed."""
        self.pose = x_m, y_m, yaw_rad
        self._counted_m = left_m, right_m


def moved(pose: Pose2D, ahead_m: float, turn_rad: float) -> Pose2D:
    """Return the pose at the end of an arc of length `ahead_m` with a constant turn by `turn_rad`."""
    x_m, y_m, yaw_rad = pose
    half_rad = turn_rad / 2
    chord_m = ahead_m * math.sin(half_rad) / half_rad if abs(half_rad) > STRAIGHT_RAD else ahead_m
    heading_rad = yaw_rad + half_rad
    return x_m + chord_m * math.cos(heading_rad), y_m + chord_m * math.sin(heading_rad), yaw_rad + turn_rad
