"""Localizer: the pose estimate of one robot, from its odometry and from fixes that arrive late."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Iterable
from enum import Enum
from typing import Final

from eal_actors.device.localization.fix_gate import FixGate, inflated
from eal_actors.device.localization.odometry_noise import OdometryNoise
from eal_actors.device.localization.pose_estimate import Covariance, Pose, PoseEstimate, diagonal
from eal_actors.device.localization.pose_filter import FilterState
from eal_actors.device.localization.pose_history import HISTORY_S, PoseHistory
from eal_actors.kernel.errors import ArgumentError, NotReadyError
from eal_actors.kernel.log import get_logger

EXACT: Final = diagonal(1e-3, 1e-3)
"""The covariance of a pose that defines the frame, or that a simulation knows."""
BY_HAND: Final = diagonal(0.01, 0.02)
"""The covariance of a pose that a person measured and set."""
UNKNOWN: Final = diagonal(100.0, 10.0)
"""The covariance before the first fix of a robot whose start is not known."""
MOST_AHEAD_S: Final = 1.0
"""A fix whose time is further ahead of the odometry than this has a wrong time."""
_MOST_PENDING: Final = 32
_ROUNDING_S: Final = 1e-6
_WARN_S: Final = 10.0


class FixOutcome(Enum):
    """The outcome of a fix."""

    APPLIED = "applied"
    PENDING = "pending"  # until the odometry of its time has arrived
    REPEATED = "repeated"  # it was applied already: it came by two ways
    REFUSED = "refused"  # it is too far from the estimate, or too old
    RELOCALISED = "relocalised"  # the estimate began again from it, after a series of consistent refused fixes


def _nothing() -> None:
    """Do nothing."""


class Localizer:
    """The pose estimate of one robot, by the odometry of one driver. Thread: any; nothing blocks."""

    def __init__(self, robot: str = "") -> None:
        self.robot: Final = robot
        self._lock = threading.Lock()
        self._history = PoseHistory(lambda: FilterState.at(*self._start, self._history.noise))
        self._gate = FixGate()
        self._pending: deque[PoseEstimate] = deque(maxlen=_MOST_PENDING)
        self._start: tuple[Pose, Covariance] = ((0.0, 0.0, 0.0), EXACT)
        self._has_given_start = False
        self._has_new_driver = False
        self._refresh: Callable[[], object] = _nothing
        self._not_ready: Callable[[], str | None] = _nothing
        self._warned_s = -math.inf
        self._log = get_logger(robot=robot)

    # The driver of the wheels.

    def attach(
        self,
        noise: OdometryNoise,
        *,
        refresh: Callable[[], object] | None = None,
        not_ready: Callable[[], str | None] | None = None,
    ) -> None:
        """Begin to take the odometry of a driver, which calls this when it connects, also after a restart.

        `refresh` brings the odometry up to date before each reading, without blocking; it raises an EALError if the
        odometry is too old to be read. `not_ready` is as Resource.not_ready.
        """
        with self._lock:
            self._history.noise = noise
            self._refresh, self._not_ready = refresh or _nothing, not_ready or _nothing
            self._has_new_driver = True

    def odometry(self, x_m: float, y_m: float, yaw_rad: float, stamp_s: float) -> None:
        """Add the pose by odometry at a time; earlier times than the latest are ignored.

        The pose is in any frame that stays the same, see `restart_odometry`; its yaw may be wrapped. `stamp_s` is when
        the wheels were there, by the fleet's clock.
        """
        self.odometry_path([(x_m, y_m, yaw_rad, stamp_s)])

    def odometry_path(self, path: Iterable[tuple[float, float, float, float]]) -> None:
        """Add poses by odometry, oldest first: the arguments of `odometry` for each."""
        with self._lock:
            for x_m, y_m, yaw_rad, stamp_s in path:
                if self._has_new_driver:
                    self._restart((x_m, y_m, yaw_rad), stamp_s)
                elif stamp_s > self._history.last_s:
                    self._history.add((x_m, y_m, yaw_rad), stamp_s)
                while self._pending and self._pending[0].stamp_s <= stamp_s + _ROUNDING_S:
                    self._apply(self._pending.popleft())

    def restart_odometry(self, x_m: float, y_m: float, yaw_rad: float, stamp_s: float) -> None:
        """Continue from another pose by odometry: it was set, and the robot has not moved."""
        with self._lock:
            self._restart((x_m, y_m, yaw_rad), stamp_s)

    def _restart(self, pose: Pose, stamp_s: float) -> None:
        """Continue from another pose by odometry. Thread: holds the lock."""
        self._has_new_driver = False
        if self._history:
            self._gate.forget()
        self._history.restart(pose, stamp_s)

    # The place.

    def begin_at(
        self, x_m: float, y_m: float, yaw_rad: float, covariance: Covariance = EXACT, *, is_given: bool = False
    ) -> None:
        """Set the pose in the map at which the odometry begins; it is ignored once it has begun.

        A pose that `is_given` is that of the fleet file, so that no driver knows better.
        """
        with self._lock:
            if is_given or not self._has_given_start:
                self._start = (x_m, y_m, yaw_rad), covariance
                self._has_given_start = is_given

    def place(self, x_m: float, y_m: float, yaw_rad: float, covariance: Covariance = BY_HAND) -> None:
        """Set the estimate: the robot is there now. The odometry's errors that are known stay known."""
        pose = x_m, y_m, yaw_rad
        self._refresh()
        with self._lock:
            if self._history:
                self._history.reset(self._history.head().moved_to(pose, covariance))
                self._gate.forget()
                self._pending.clear()
            else:
                self._start, self._has_given_start = (pose, covariance), True

    def not_ready(self) -> str | None:
        """Return why the robot's odometry cannot be read now; None if it can."""
        return self._not_ready()

    def estimate(self, now_s: float) -> PoseEstimate:
        """Return the estimate at a time.

        `now_s` is in seconds of the fleet's clock. For a time after the latest odometry, it is the estimate at the
        latest odometry; for a time before the history of a few seconds, the oldest one.

        Raises:
            NotReadyError: no odometry has arrived yet.
            UnavailableError: the latest odometry is too old.
        """
        self._refresh()
        with self._lock:
            self._require_odometry()
            return self._history.estimate(now_s)

    # Fixes.

    def fix(self, fix: PoseEstimate) -> FixOutcome:
        """Correct the estimate by a fix at its own time, which may be up to `HISTORY_S` ago.

        Raises:
            ArgumentError: its time is ahead of the odometry by more than a second.
            NotReadyError: no odometry has arrived yet.
            UnavailableError: the latest odometry is too old.
        """
        self._refresh()
        with self._lock:
            self._require_odometry()
            ahead_s = fix.stamp_s - self._history.last_s
            if not ahead_s <= MOST_AHEAD_S:
                raise ArgumentError(
                    f"the fix of {self.robot} is {ahead_s:.3f} s ahead of its odometry: its stamp_s must be the time "
                    "of exposure, in seconds of the fleet's clock"
                )
            if ahead_s > _ROUNDING_S:
                self._pending.append(fix)
                return FixOutcome.PENDING
            return self._apply(fix)

    def _apply(self, fix: PoseEstimate) -> FixOutcome:
        """Apply a fix within the history, or refuse it. Thread: holds the lock."""
        history = self._history
        if fix.stamp_s < history.first_s:
            self._warn("a fix is too old", fix, f"it is older than the odometry, which is kept for {HISTORY_S:g} s")
            return FixOutcome.REFUSED
        if history.has(fix):
            return FixOutcome.REPEATED
        moment = history.moment(fix.stamp_s)
        if self._gate.admits(moment, fix):
            history.insert(moment, fix)
            return FixOutcome.APPLIED
        x_m, y_m, _ = moment.state.mean[:3]
        jump = f"{math.hypot(fix.x_m - x_m, fix.y_m - y_m):.2f} m from the estimate"
        if not self._gate.must_begin_again(moment, fix, history.noise):
            self._warn("a fix is refused", fix, jump)
            return FixOutcome.REFUSED
        pose = fix.x_m, fix.y_m, fix.yaw_rad
        history.begin_again(moment, fix.stamp_s, moment.state.moved_to(pose, inflated(fix.covariance)))
        self._log.warning(
            "localised again from fixes", reason=f"they agree, {jump}: the robot was carried or its pose was lost"
        )
        return FixOutcome.RELOCALISED

    def _require_odometry(self) -> None:
        if not self._history:
            raise NotReadyError(f"the pose of {self.robot or 'the robot'} is unknown: no odometry has arrived yet")

    def _warn(self, event: str, fix: PoseEstimate, reason: str) -> None:
        """Log a warning, at most one in 10 s. Thread: holds the lock."""
        if fix.stamp_s - self._warned_s >= _WARN_S:
            self._warned_s = fix.stamp_s
            self._log.warning(event, reason=reason, x_m=round(float(fix.x_m), 3), y_m=round(float(fix.y_m), 3))
