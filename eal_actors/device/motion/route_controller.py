"""The controller of a motion: from the robot's pose to the twist for the next step. It reads no clock and no sensor.

On the way the robot aims at a point of the route a little ahead (pure pursuit). Before a corner that point is straight
on: the corner itself is soon so near that noise of the pose would swing the robot. It turns in place where the point is
far to its side, and at corners. Within a few centimetres of the end it may drive backwards, so that it need not turn
round for a correction. It ends with a turn in place to the goal's heading.

Source: R. C. Coulter, "Implementation of the Pure Pursuit Path Tracking Algorithm", CMU-RI-TR-92-01, 1992.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

from eal_actors.device.localization.pose_estimate import Pose
from eal_actors.device.localization.pose_filter import between
from eal_actors.device.motion.route import Route

ARRIVED_M: Final = 0.004
ARRIVED_RAD: Final = math.radians(0.4)
"""Within these of its goal the robot stops."""
STAYS: Final = 2.0
"""A robot that has stopped corrects only what exceeds these tolerances by this factor."""

_LOOK_AHEAD_M: Final = 0.12
_LOOK_AHEAD_S: Final = 0.4
_TURN_IN_PLACE_RAD: Final = math.radians(35)  # a point farther to the side is aimed at in place
_AIMED_RAD: Final = math.radians(3)
_PASSED_M: Final = 0.01  # before a corner
_NEAR_M: Final = 0.15  # from the end; the robot may drive backwards
_STRAIGHT_M: Final = 0.03  # from the end; the robot only drives straight, since its bearing means little
_STRAIGHT_RAD: Final = math.radians(15)
_CREEP_M_S: Final = 0.012
_CREEP_RAD_S: Final = math.radians(3)
_BRAKE_SHARE: Final = 0.5  # of the acceleration, so that the wheels can follow


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """The limits of a motion, each over 0.

    `acceleration_m_s2` is that of the robot's centre; `delay_s` is from a pose to the effect of the twist that it
    causes.
    """

    speed_m_s: float
    turn_rate_rad_s: float
    acceleration_m_s2: float
    turn_acceleration_rad_s2: float
    delay_s: float = 0.12


class PlanarTwist(NamedTuple):
    """A speed forward and a turn rate counter-clockwise."""

    speed_m_s: float
    turn_rate_rad_s: float


STANDSTILL: Final = PlanarTwist(0.0, 0.0)


def braking_speed(left: float, acceleration: float, delay_s: float) -> float:
    """Return the greatest speed from which a remaining length, or angle, suffices to stop, after a delay."""
    lost = acceleration * delay_s
    return math.sqrt(2 * acceleration * max(left, 0.0) + lost * lost) - lost


class RouteController:
    """Drives along a route to its end, and turns to a heading there.

    The route begins at the robot's place; `yaw_rad` is the heading at the goal, None for any. `turn_left_rad` is the
    angle to go while it turns in place, and None while it drives.
    """

    def __init__(self, route: Route, yaw_rad: float | None, limits: MotionLimits) -> None:
        self._route = route
        self._yaw_rad = yaw_rad
        self._limits = limits
        self._sharpest = limits.turn_acceleration_rad_s2 / limits.acceleration_m_s2  # at it, one wheel stands
        self._twist = STANDSTILL
        self._rolling_m_s = 0.0
        self._is_at_end = False
        self._is_turning = False
        self.is_at_goal = False
        self.turn_left_rad: float | None = None

    def errors(self, pose: Pose) -> tuple[float, float]:
        """Return the distance to the goal in m, and the angle to its heading in rad; 0 for any heading."""
        end_x, end_y = self._route.end
        off_rad = math.remainder(self._yaw_rad - pose[2], math.tau) if self._yaw_rad is not None else 0.0
        return math.hypot(end_x - pose[0], end_y - pose[1]), off_rad

    def is_within(self, pose: Pose, factor: float = 1.0) -> bool:
        """Return whether a pose is within the tolerances of the goal, at the end of the route."""
        off_m, off_rad = self.errors(pose)
        is_last = self._route.length_m - self._route.travelled_m <= _NEAR_M
        return is_last and off_m <= factor * ARRIVED_M and abs(off_rad) <= factor * ARRIVED_RAD

    def left_m(self, pose: Pose) -> float:
        """Return the distance to go along the route."""
        route = self._route
        return max(route.length_m - route.travelled_m, self.errors(pose)[0])

    def step(self, pose: Pose, duration_s: float) -> PlanarTwist:
        """Return the twist for the next step, a duration after the step before; a standstill at the goal."""
        self._route.advance(pose[0], pose[1])
        twist = self._wanted(pose)
        limits = self._limits
        gain_m_s, gain_rad_s = limits.acceleration_m_s2 * duration_s, limits.turn_acceleration_rad_s2 * duration_s
        self._rolling_m_s = max(self._wheel_m_s(), self._rolling_m_s - gain_m_s)
        if not twist.speed_m_s and self._rolling_m_s > gain_m_s:
            twist = STANDSTILL  # a wheel that brakes for a turn lags behind, and the robot drives on: it stops first
        self._twist = PlanarTwist(
            _gained(self._twist.speed_m_s, twist.speed_m_s, gain_m_s),
            _gained(self._twist.turn_rate_rad_s, twist.turn_rate_rad_s, gain_rad_s),
        )
        return self._twist

    def _wheel_m_s(self) -> float:
        """Return the speed of the faster wheel while it drives; 0 while it turns in place."""
        speed_m_s, rate_rad_s = self._twist
        return abs(speed_m_s) + abs(rate_rad_s) / self._sharpest if speed_m_s else 0.0

    def pause(self) -> PlanarTwist:
        """Stand for a step; return the twist."""
        self._twist = STANDSTILL
        return STANDSTILL

    def slow_down(self, speed_m_s: float) -> PlanarTwist:
        """Drive the same curve no faster than this, because something is in the way; return the twist."""
        before = self._twist
        if abs(before.speed_m_s) > speed_m_s:
            share = speed_m_s / abs(before.speed_m_s)
            self._twist = PlanarTwist(before.speed_m_s * share, before.turn_rate_rad_s * share)
        return self._twist

    def _wanted(self, pose: Pose) -> PlanarTwist:
        off_m, off_rad = self.errors(pose)
        left_m = self._route.length_m - self._route.travelled_m
        self._is_at_end = left_m <= _NEAR_M and off_m <= (STAYS if self._is_at_end else 1.0) * ARRIVED_M
        if not self._is_at_end:
            self.is_at_goal = False
            return self._approach(pose)
        self.is_at_goal = abs(off_rad) <= (STAYS if self.is_at_goal else 1.0) * ARRIVED_RAD
        self._is_turning = True  # if the turn moves it, it aims anew
        return STANDSTILL if self.is_at_goal else self._turn(off_rad)

    def _approach(self, pose: Pose) -> PlanarTwist:
        route = self._route
        if route.corner_m < route.length_m and route.corner_m - route.travelled_m < _PASSED_M:
            route.pass_corner()
            self._is_turning = True
        aim_m = route.travelled_m + max(_LOOK_AHEAD_M, _LOOK_AHEAD_S * abs(self._twist.speed_m_s))
        is_last = route.corner_m >= route.length_m <= aim_m
        ahead_m, side_m, _ = between(pose, (*(route.end if is_last else route.point_ahead(aim_m)), 0.0))
        distance_m = math.hypot(ahead_m, side_m)
        sense = -1.0 if is_last and ahead_m < 0 and distance_m < _NEAR_M else 1.0
        bearing_rad = math.atan2(sense * side_m, sense * ahead_m)
        if self._is_turning or abs(bearing_rad) > _TURN_IN_PLACE_RAD:
            self._is_turning = abs(bearing_rad) > _AIMED_RAD
            if self._is_turning:
                return self._turn(bearing_rad)
        to_stop_m = distance_m if is_last else route.corner_m - route.travelled_m
        self.turn_left_rad = None
        speed_m_s = min(self._limits.speed_m_s, self._braking_m_s(to_stop_m))
        is_straight = is_last and distance_m < _STRAIGHT_M and abs(bearing_rad) < _STRAIGHT_RAD
        bend = 0.0 if is_straight else 2 * math.sin(bearing_rad) / max(distance_m, _STRAIGHT_M)
        # Wheels brake one by one: with one that turns backwards, the robot would roll on past its end.
        bend = max(-self._sharpest, min(bend, self._sharpest))
        if abs(bend) * speed_m_s > self._limits.turn_rate_rad_s:
            speed_m_s = self._limits.turn_rate_rad_s / abs(bend)
        return PlanarTwist(sense * speed_m_s, speed_m_s * bend)

    def _braking_m_s(self, left_m: float) -> float:
        limits = self._limits
        return max(braking_speed(left_m, _BRAKE_SHARE * limits.acceleration_m_s2, limits.delay_s), _CREEP_M_S)

    def _turn(self, angle_rad: float) -> PlanarTwist:
        limits, self.turn_left_rad = self._limits, angle_rad
        brake_rad_s2 = _BRAKE_SHARE * limits.turn_acceleration_rad_s2
        rate_rad_s = max(braking_speed(abs(angle_rad), brake_rad_s2, limits.delay_s), _CREEP_RAD_S)
        return PlanarTwist(0.0, math.copysign(min(rate_rad_s, limits.turn_rate_rad_s), angle_rad))


def _gained(before: float, wanted: float, gain: float) -> float:
    """Return a speed nearer to the wanted one; only its growth is limited."""
    if before * wanted < 0:
        return math.copysign(min(abs(wanted), gain), wanted)
    return math.copysign(min(abs(wanted), abs(before) + gain), wanted)
