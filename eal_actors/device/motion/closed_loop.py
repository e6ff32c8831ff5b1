"""The activity of a closed-loop motion: twenty times a second it reads the pose and sets a twist.

A twist ends by itself when the loop does not renew it, so a loop that is late or gone never leaves a robot driving. A
busy computer or a slow wire may keep readings away for a second or two: the robot stands meanwhile, and then drives on.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from eal_actors.device.localization.pose_estimate import Pose, PoseEstimate
from eal_actors.device.motion.route_controller import (
    STANDSTILL,
    STAYS,
    MotionLimits,
    PlanarTwist,
    RouteController,
    braking_speed,
)
from eal_actors.device.resource import Activity
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import BlockedError, EALError, LocalizationError, UnavailableError

PERIOD_S: Final = 0.05
"""Between two twists."""
PATIENCE_S: Final = 5.0
"""A robot that has not come nearer to its goal, or whose readings have been away, for so long gives up."""
MOST_YAW_RAD: Final = math.radians(30)
"""Greatest standard deviation of the yaw with which a robot drives."""

_TWIST_S: Final = 0.4  # a twist that is not renewed ends
_STALE_S: Final = 0.5  # age of a pose that is too old
_REST_S: Final = 0.25  # at the goal, before the motion is done
_MARGIN_M: Final = 0.05  # to an obstacle
_NEARER_M: Final = 0.005
_NEARER_RAD: Final = math.radians(1)
_PUSH_S: Final = 0.3  # a robot that is held for so long pauses: its wheels spin, and its odometry counts that
_PAUSE_S: Final = 1.0
_MOST_PAUSES: Final = 3
_MOST_TURNS_RAD: Final = 3 * math.pi  # that count as coming nearer without any travel
_JUMP_M: Final = 0.2  # of the distance to go, from one pose to the next
_MOST_JUMPS: Final = 5


@dataclass(frozen=True, slots=True)
class MotionDevice:
    """The parts of a base that a closed-loop motion uses.

    Attributes:
        estimate: returns the estimated pose at a time.
        hold: drives at a twist until a time-out, see DifferentialBase.follow.
        clearance_m: returns the free distance ahead (True) or behind (False), see DifferentialBase.clearance_m.
        is_held: whether the wheels are driven, but something holds the robot.
    """

    clock: Clock
    estimate: Callable[[float], PoseEstimate]
    hold: Callable[[float, float, float], Activity]
    clearance_m: Callable[[bool], float]
    is_held: Callable[[], bool]
    halt: Callable[[], None]
    report: Callable[[float], None]


class ProgressWatch:
    """Finds that a robot does not come nearer to its goal."""

    def __init__(self, now_s: float) -> None:
        self._nearer_s = now_s
        self._best_m = self._best_rad = self._last_m = math.inf
        self._turned_rad = 0.0
        self._jumps = 0

    def update(self, left_m: float, turn_left_rad: float | None, now_s: float) -> float:
        """Return the time for which the robot has not come nearer; `turn_left_rad` is None while it drives.

        Raises LocalizationError if the pose has jumped too often.
        """
        if left_m > self._last_m + _JUMP_M:
            self._jumps += 1
            if self._jumps > _MOST_JUMPS:
                raise LocalizationError(
                    f"halted: the pose has jumped {self._jumps} times; see where its fixes are from"
                )
            self._best_m = math.inf
        self._last_m = left_m
        if left_m < self._best_m - _NEARER_M:
            self._best_m, self._best_rad, self._turned_rad, self._nearer_s = left_m, math.inf, 0.0, now_s
        elif turn_left_rad is None:
            self._best_rad = math.inf
        elif abs(turn_left_rad) < self._best_rad - _NEARER_RAD and self._turned_rad < _MOST_TURNS_RAD:
            self._turned_rad += min(self._best_rad - abs(turn_left_rad), _NEARER_RAD)
            self._best_rad, self._nearer_s = abs(turn_left_rad), now_s
        return now_s - self._nearer_s

    def excuse(self, duration_s: float) -> None:
        """Leave out a time in which the robot had to stand."""
        self._nearer_s += duration_s


class HoldWatch:
    """Pauses a robot that is held: its wheels may spin, and its odometry counts that.

    `gives_up` is whether it was held again after each of some pauses.
    """

    def __init__(self, now_s: float) -> None:
        self.gives_up = False
        self._free_s = now_s
        self._paused_until_s = -math.inf
        self._pauses = 0

    def must_pause(self, now_s: float, *, is_held: bool) -> bool:
        """Return whether the robot must stand now."""
        if now_s < self._paused_until_s:
            self._free_s = now_s
        elif not is_held:
            self._free_s = now_s
            if now_s > self._paused_until_s + _PAUSE_S:
                self._pauses = 0
        elif now_s - self._free_s > _PUSH_S:
            self._pauses += 1
            self._paused_until_s = now_s + _PAUSE_S
            self.gives_up = self._pauses > _MOST_PAUSES
        return now_s < self._paused_until_s


class ClosedLoop:
    """One motion of a base to the end of a route.

    `most_m` is the greatest standard deviation of the position with which it drives.
    """

    def __init__(self, device: MotionDevice, controller: RouteController, limits: MotionLimits, most_m: float) -> None:
        self._device = device
        self._controller = controller
        self._limits = limits
        self._most_m = most_m
        self._twist = STANDSTILL
        self._obstacle = ""
        self._holds = HoldWatch(device.clock.now())
        self._silent_since_s: float | None = None

    def run(self) -> Activity:
        """Drive to the goal, and return 1 at rest there; any other end stops the motors.

        Raises:
            BlockedError: it does not come nearer to its goal.
            LocalizationError: the pose is too uncertain, or stays too old.
            UnavailableError: the base stays silent.
        """
        clock = self._device.clock
        watch, rest_s, stepped_s = ProgressWatch(clock.now()), 0.0, clock.now() - PERIOD_S
        whole_m = 0.0
        try:
            while rest_s < _REST_S:
                pose = yield from self._fresh_pose()
                now_s = clock.now()
                if self._silent_since_s is not None:
                    watch.excuse(now_s - stepped_s)
                    stepped_s = now_s - PERIOD_S
                whole_m = whole_m or max(self._controller.left_m(pose), _MARGIN_M)
                self._twist = self._next_twist(pose, now_s - stepped_s)
                rest_s = rest_s + now_s - stepped_s if self._controller.is_at_goal else 0.0
                stepped_s, left_m = now_s, self._controller.left_m(pose)
                turn_rad = self._controller.turn_left_rad
                stalled_s = 0.0 if self._controller.is_at_goal else watch.update(left_m, turn_rad, now_s)
                if stalled_s > PATIENCE_S or self._holds.gives_up:
                    raise self._blocked(left_m)
                self._device.report(1 - left_m / whole_m)
                yield from self._hold(self._twist)
            return 1
        finally:
            self._device.halt()

    def _next_twist(self, pose: Pose, duration_s: float) -> PlanarTwist:
        """Return the twist for a pose; slower, down to a standstill, before something that sensors see."""
        twist, now_s = self._controller.step(pose, duration_s), self._device.clock.now()
        self._obstacle = ""
        if self._holds.must_pause(now_s, is_held=self._device.is_held()):
            self._obstacle = "its wheels are driven, but something holds it"
            return self._controller.pause()
        if twist.speed_m_s:
            clear_m = self._device.clearance_m(twist.speed_m_s > 0)
            if clear_m <= _MARGIN_M + _NEARER_M:  # it creeps there
                side = "ahead" if twist.speed_m_s > 0 else "behind"
                self._obstacle = (
                    f"something is {max(clear_m, 0.0):.2f} m {side}" if clear_m else f"it touches something {side}"
                )
            limits = self._limits
            slow_m_s = braking_speed(clear_m - _MARGIN_M, limits.acceleration_m_s2 / 2, limits.delay_s)
            return self._controller.slow_down(slow_m_s)
        return twist

    def _blocked(self, left_m: float) -> BlockedError:
        why = self._obstacle or "see whether the goal is reachable, its wheels turn, and its pose is right"
        return BlockedError(f"halted {left_m:.2f} m from its goal: for {PATIENCE_S:g} s it has not come nearer: {why}")

    def _fresh_pose(self) -> Activity:
        """Return the pose; the robot stands until there is a fresh one.

        Raises:
            LocalizationError: the pose is too uncertain, or stays too old.
            UnavailableError: the base stays silent.
        """
        while True:
            now_s = self._device.clock.now()
            try:
                estimate = self._device.estimate(now_s)
            except UnavailableError as error:
                self._wait_out(error)
            else:
                pose, age_s = self._pose(estimate, now_s), now_s - estimate.stamp_s
                if age_s <= _STALE_S or self._controller.is_within(pose, STAYS):
                    return pose
                self._wait_out(self._lost(pose, f"its pose is {age_s:.2f} s old, and may be {_STALE_S:g} s old"))
            yield PERIOD_S

    def _wait_out(self, error: EALError) -> None:
        """Let the robot stand, as its base does by itself without new twists; raise the error if it lasts."""
        now_s = self._device.clock.now()
        if self._silent_since_s is None:
            self._silent_since_s = now_s
        if now_s - self._silent_since_s > PATIENCE_S:
            raise error
        self._twist = self._controller.pause()

    def _pose(self, estimate: PoseEstimate, now_s: float) -> Pose:
        """Return the pose now: the estimate, and what the last twist has added since.

        Raises LocalizationError if the pose is too uncertain, and not at the goal.
        """
        age_s = min(max(now_s - estimate.stamp_s, 0.0), _STALE_S)
        x_m, y_m, yaw_rad = estimate.x_m, estimate.y_m, estimate.yaw_rad
        if age_s:
            half_rad = self._twist.turn_rate_rad_s * age_s / 2
            way_m = self._twist.speed_m_s * age_s
            x_m += way_m * math.cos(yaw_rad + half_rad)
            y_m += way_m * math.sin(yaw_rad + half_rad)
            yaw_rad += 2 * half_rad
        pose = x_m, y_m, yaw_rad
        why = self._why_unsure(estimate)
        if why is not None and not self._controller.is_within(pose, STAYS):
            raise self._lost(pose, why)
        return pose

    def _lost(self, pose: Pose, why: str) -> LocalizationError:
        return LocalizationError(f"halted {self._controller.errors(pose)[0]:.2f} m from its goal: {why}")

    def _why_unsure(self, estimate: PoseEstimate) -> str | None:
        std_m, std_rad = estimate.position_std_m, estimate.yaw_std_rad
        if not (std_m <= self._most_m and std_rad <= MOST_YAW_RAD):
            return (
                f"the standard deviation of its pose is {std_m:.2f} m and {math.degrees(std_rad):.0f} degrees, over "
                f"{self._most_m:g} m or {math.degrees(MOST_YAW_RAD):.0f} degrees: it needs fixes, or set its Pose"
            )
        return None

    def _hold(self, twist: PlanarTwist) -> Activity:
        """Drive at a twist for one period; a silent base stands and is tried again; raise UnavailableError at last."""
        clock = self._device.clock
        end_s = clock.now() + PERIOD_S
        activity = self._device.hold(*twist, _TWIST_S)
        try:
            for delay_s in activity:
                left_s = end_s - clock.now()
                if delay_s >= left_s:
                    break
                yield delay_s
            self._silent_since_s = None
        except UnavailableError as error:
            self._wait_out(error)
        finally:
            activity.close()
        yield max(end_s - clock.now(), 0.0)
