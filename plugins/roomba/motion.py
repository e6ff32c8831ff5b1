"""Motions by encoder counts: the speed for a remaining length, and the progress."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Final

from eal_actors.plugin import WheelCalibration

from .reading import RoombaReading

MAX_SPEED_MM_S: Final = 500
"""Maximum speed of a wheel of every Roomba."""
MAX_TURN_RATE_DEG_S: Final = 180.0
BRAKE_M_S2: Final = 0.3
_CREEP_M_S: Final = 0.02  # the speed at the end of a motion; the robot rests within a millimetre


@dataclass(frozen=True, slots=True)
class TimedMotion:
    """One straight drive or turn in place.

    Attributes:
        length_m: the travel, 0 or more; of a turn, along a circle through the wheels.
        speed_m_s: the greatest speed along it.
        ahead: 1 for forward, -1 for back, 0 for a turn in place.
        arc: 1 for a left turn, -1 for a right turn, 0 for a straight drive.
        calibration: of the wheels.
    """

    length_m: float
    speed_m_s: float
    ahead: int
    arc: int
    calibration: WheelCalibration

    @classmethod
    def straight(cls, distance_m: float, speed_m_s: float, calibration: WheelCalibration) -> TimedMotion:
        """Return a straight drive; a negative distance is backwards."""
        return cls(abs(distance_m), speed_m_s, -1 if distance_m < 0 else 1, 0, calibration)

    @classmethod
    def turn(
        cls, angle_rad: float, rate_rad_s: float, wheelbase_m: float, calibration: WheelCalibration
    ) -> TimedMotion:
        """Return a turn in place; a positive angle is to the left."""
        arm_m = wheelbase_m / 2
        return cls(abs(angle_rad) * arm_m, rate_rad_s * arm_m, 0, -1 if angle_rad < 0 else 1, calibration)

    def slower(self, speed_m_s: float) -> TimedMotion:
        """Return the motion with a limit of its speed."""
        return replace(self, speed_m_s=min(self.speed_m_s, speed_m_s))

    def back(self, length_m: float) -> TimedMotion:
        """Return the motion back over a length."""
        return replace(self, length_m=length_m, ahead=-self.ahead, arc=-self.arc)

    def counted_m(self, reading: RoombaReading) -> float:
        """Return the total travel in the direction of the motion."""
        ahead_m, arc_m = self.calibration.travelled(reading.left_m, reading.right_m)
        return self.ahead * ahead_m + self.arc * arc_m

    @property
    def goes_forward(self) -> bool:
        """Whether it moves towards the side of the cliff sensors."""
        return self.ahead > 0

    def wheels_mm_s(self, velocity_mm_s: int) -> tuple[int, int]:
        """Return the speeds of the left and the right wheel for a speed of the robot."""
        left, right = self.calibration.counted(self.ahead * velocity_mm_s, self.arc * velocity_mm_s)
        return _reached(left), _reached(right)

    def left_m(self, reading: RoombaReading, start_m: float) -> float:
        """Return the remaining length at a reading; `start_m` is the count at the beginning."""
        return self.length_m - (self.counted_m(reading) - start_m)

    def velocity_mm_s(self, left_m: float) -> int:
        """Return the speed of each wheel for a remaining length, 1 or more."""
        slowing_m_s = math.sqrt(_CREEP_M_S**2 + 2 * BRAKE_M_S2 * max(left_m, 0.0))
        return max(1, min(MAX_SPEED_MM_S, round(min(self.speed_m_s, slowing_m_s) * 1000)))


@dataclass(frozen=True, slots=True)
class MotionGoal:
    """The pose in which a motion should end: x in m, y in m, yaw in rad."""

    x_m: float
    y_m: float
    yaw_rad: float

    @classmethod
    def of(cls, pose: tuple[float, float, float], ahead_m: float, turn_rad: float) -> MotionGoal:
        """Return the goal of a motion that begins in a pose."""
        x_m, y_m, yaw_rad = pose
        return cls(x_m + ahead_m * math.cos(yaw_rad), y_m + ahead_m * math.sin(yaw_rad), yaw_rad + turn_rad)

    def off(self, pose: tuple[float, float, float]) -> tuple[float, float]:
        """Return the distance from the goal in m, and the angle to turn in rad, in (-pi, pi]."""
        x_m, y_m, yaw_rad = pose
        return math.hypot(x_m - self.x_m, y_m - self.y_m), math.remainder(self.yaw_rad - yaw_rad, math.tau)


class MotionProgress:
    """The progress of a motion: from the encoders at each reading, extrapolated by the speeds commanded since.

    Attributes:
        stalled_s: time without an encoder count while the wheels are driven, until the latest reading.
    """

    def __init__(self, motion: TimedMotion, start_m: float, now_s: float) -> None:
        self.velocity_mm_s = 0
        self.stalled_s = 0.0
        self._motion = motion
        self._start_m = start_m
        self._reading: RoombaReading | None = None
        self._moved_s = now_s
        self._commands: deque[tuple[float, int]] = deque([(-math.inf, 0)])

    def command(self, velocity_mm_s: int, now_s: float) -> None:
        """Record a commanded speed."""
        if not self.velocity_mm_s:
            self._moved_s = now_s
        self.velocity_mm_s = velocity_mm_s
        self._commands.append((now_s, velocity_mm_s))

    def update(self, reading: RoombaReading, now_s: float) -> float:
        """Return the remaining length now."""
        if reading is not self._reading:
            self._reading = reading
            if not reading.stands:
                self._moved_s = reading.stamp_s
            while len(self._commands) > 1 and self._commands[1][0] <= reading.stamp_s:
                self._commands.popleft()
        self.stalled_s = reading.stamp_s - self._moved_s if self.velocity_mm_s else 0.0
        return self._motion.left_m(reading, self._start_m) - self._since_m(reading.stamp_s, now_s)

    def _since_m(self, since_s: float, now_s: float) -> float:
        """Return the travel by the commands since a time."""
        ends = [*(time_s for time_s, _ in self._commands), now_s][1:]
        return sum(
            velocity_mm_s / 1000 * (end_s - max(time_s, since_s))
            for (time_s, velocity_mm_s), end_s in zip(self._commands, ends, strict=True)
            if end_s > since_s
        )


def _reached(speed_mm_s: float) -> int:
    """Return the nearest possible wheel speed, which is not 0."""
    nearest = round(max(-MAX_SPEED_MM_S, min(MAX_SPEED_MM_S, speed_mm_s)))
    return nearest or (1 if speed_mm_s > 0 else -1)


def slowed(speed_m_s: float, turn_rate_rad_s: float, wheelbase_m: float) -> tuple[float, float]:
    """Return a twist within the speed limit of both wheels: if one is too fast, the same curve, driven slower.

    Speeds are positive forward, and turn rates counter-clockwise.
    """
    excess = max(1.0, (abs(speed_m_s) + abs(turn_rate_rad_s) * wheelbase_m / 2) * 1000 / MAX_SPEED_MM_S)
    return speed_m_s / excess, turn_rate_rad_s / excess
