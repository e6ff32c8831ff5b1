"""Localizer: the pose estimate of one robot, from its odometry and from fixes that arrive late.

It keeps a short history of the odometry. Odometry arrives often and is read seldom, so `odometry` only appends a
sample; the filter runs when somebody reads. Samples that leave the history are merged into a few steps of the filter,
so a robot whose pose nobody reads costs about 1 % of a core at most.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from eal_actors.device.localization.odometry_noise import OdometryNoise
from eal_actors.device.localization.pose_estimate import Covariance, PoseEstimate, diagonal
from eal_actors.device.localization.pose_filter import FilterState, Pose, between, beyond, predict
from eal_actors.kernel.errors import NotReadyError

HISTORY_S: Final = 3.0
"""How long samples of the odometry are kept; a fix that is older cannot be applied."""
_SPACING_S: Final = 0.04
_MOST_SAMPLES: Final = 128
_STEP_M: Final = 0.1
_STEP_RAD: Final = 0.3
EXACT: Final = diagonal(1e-3, 1e-3)
"""The covariance of a pose that defines the frame, or that a simulation knows."""
BY_HAND: Final = diagonal(0.01, 0.02)
"""The covariance of a pose that a person measured and set."""


@dataclass(slots=True)
class _Sample:
    """The odometry at a time, and the filter's state then, once it is computed."""

    stamp_s: float
    odometry: Pose
    state: FilterState | None = None


def _nothing() -> None:
    """Do nothing."""


class Localizer:
    """The pose estimate of one robot, shared by its plugins.

    Args:
        robot: the robot's name, for messages.

    Attributes:
        noise: the errors of the robot's odometry.

    Thread: any.
    """

    def __init__(self, robot: str = "") -> None:
        self.robot: Final = robot
        self.noise = OdometryNoise()
        self._lock = threading.Lock()
        self._samples: list[_Sample] = []
        self._start: tuple[Pose, Covariance] = ((0.0, 0.0, 0.0), EXACT)
        self._has_new_driver = False
        self._refresh: Callable[[], object] = _nothing
        self._not_ready: Callable[[], str | None] = _nothing

    def attach(
        self,
        noise: OdometryNoise,
        *,
        refresh: Callable[[], object] | None = None,
        not_ready: Callable[[], str | None] | None = None,
    ) -> None:
        """Begin to take the odometry of a driver, which calls this when it connects, also after a restart.

        Args:
            noise: the errors of its odometry.
            refresh: brings the odometry up to date before each reading, without blocking; it raises an EALError if the
                odometry is too old to be read.
            not_ready: as Resource.not_ready.
        """
        with self._lock:
            self.noise = noise
            self._refresh, self._not_ready = refresh or _nothing, not_ready or _nothing
            self._has_new_driver = True

    def begin_at(self, x_m: float, y_m: float, yaw_rad: float, covariance: Covariance = EXACT) -> None:
        """Set the pose at which the odometry begins; it is ignored once it has begun."""
        with self._lock:
            self._start = (x_m, y_m, yaw_rad), covariance

    def not_ready(self) -> str | None:
        """Return why the robot's odometry cannot be read now; None if it can."""
        return self._not_ready()

    def odometry(self, x_m: float, y_m: float, yaw_rad: float, stamp_s: float) -> None:
        """Add the pose by odometry at a time; earlier times than the latest are ignored.

        Args:
            x_m: in any frame that stays the same; see `restart_odometry`.
            y_m: likewise.
            yaw_rad: likewise; wrapped or not.
            stamp_s: when the wheels were there, in seconds of the fleet's clock.
        """
        pose = x_m, y_m, yaw_rad
        with self._lock:
            samples = self._samples
            if self._has_new_driver:
                self._restart(pose, stamp_s)
                return
            if len(samples) < 2:
                if not samples or stamp_s > samples[-1].stamp_s:
                    samples.append(_Sample(stamp_s, pose))
                return
            last, before = samples[-1], samples[-2]
            if stamp_s <= last.stamp_s:
                return
            stands = last.odometry == pose == before.odometry
            if stands or last.stamp_s - before.stamp_s < _SPACING_S:
                last.stamp_s, last.odometry, last.state = stamp_s, pose, None
                return
            samples.append(_Sample(stamp_s, pose))
            if len(samples) > _MOST_SAMPLES:
                self._forget(stamp_s - HISTORY_S)

    def restart_odometry(self, x_m: float, y_m: float, yaw_rad: float, stamp_s: float) -> None:
        """Continue from another pose by odometry: it was set, and the robot has not moved."""
        with self._lock:
            self._restart((x_m, y_m, yaw_rad), stamp_s)

    def _restart(self, pose: Pose, stamp_s: float) -> None:
        """Continue from another pose by odometry. Thread: holds the lock."""
        self._has_new_driver = False
        if self._samples:
            state, stamp_s = self._head(), max(stamp_s, self._samples[-1].stamp_s)
            self._samples = [_Sample(stamp_s, pose, state)]
        else:
            self._samples = [_Sample(stamp_s, pose)]

    def place(self, x_m: float, y_m: float, yaw_rad: float, covariance: Covariance = BY_HAND) -> None:
        """Set the estimate: the robot is there now. The odometry's errors that are known stay known."""
        pose = x_m, y_m, yaw_rad
        self._refresh()
        with self._lock:
            if self._samples:
                last = self._samples[-1]
                last.state = self._head().moved_to(pose, covariance)
                self._samples = [last]
            else:
                self._start = pose, covariance

    def estimate(self, now_s: float) -> PoseEstimate:
        """Return the estimate at a time.

        Args:
            now_s: in seconds of the fleet's clock. For a time after the latest odometry, the estimate at the latest
                odometry; for a time before the history, the oldest one.

        Raises:
            NotReadyError: no odometry has arrived yet.
            UnavailableError: the latest odometry is too old.
        """
        self._refresh()
        with self._lock:
            if not self._samples:
                raise NotReadyError(f"the pose of {self.robot or 'the robot'} is unknown: no odometry has arrived yet")
            head, last = self._head(), self._samples[-1]
            if now_s >= last.stamp_s:
                return head.estimate(last.stamp_s)
            return self._past(now_s)

    def _past(self, stamp_s: float) -> PoseEstimate:
        """Return the estimate at a time before the latest sample. Thread: holds the lock, after `_head`."""
        place = self._place_before(stamp_s)
        before = self._samples[max(place, 0)]
        state = before.state or self._begin()  # `_head` has computed all of them
        if place < 0:
            return state.estimate(before.stamp_s)
        motion = between(before.odometry, self._odometry_at(place, stamp_s))
        return predict(state, motion, self.noise).estimate(stamp_s)

    def _place_before(self, stamp_s: float) -> int:
        """Return the index of the last sample at or before a time; -1 if there is none."""
        place = len(self._samples) - 1
        while place >= 0 and self._samples[place].stamp_s > stamp_s:
            place -= 1
        return place

    def _odometry_at(self, place: int, stamp_s: float) -> Pose:
        """Return the odometry at a time between the sample at an index and the next one."""
        before, after = self._samples[place], self._samples[place + 1]
        share = (stamp_s - before.stamp_s) / (after.stamp_s - before.stamp_s)
        ahead_m, left_m, turn_rad = between(before.odometry, after.odometry)
        return beyond(before.odometry, (ahead_m * share, left_m * share, turn_rad * share))

    def _head(self) -> FilterState:
        """Return the state at the latest sample; compute what is missing. Thread: holds the lock."""
        samples = self._samples
        place = len(samples) - 1
        while place >= 0 and samples[place].state is None:
            place -= 1
        place = max(place, 0)
        state = samples[place].state = samples[place].state or self._begin()
        for before, sample in zip(samples[place:], samples[place + 1 :], strict=False):
            state = sample.state = predict(state, between(before.odometry, sample.odometry), self.noise)
        return state

    def _begin(self) -> FilterState:
        """Return the state at the first sample of all."""
        return FilterState.at(*self._start, self.noise)

    def _forget(self, until_s: float) -> None:
        """Drop the samples before a time, but the last of them, in a few steps. Thread: holds the lock."""
        samples = self._samples
        keep = max(self._place_before(until_s), 0)
        if samples[keep].state is not None:
            del samples[:keep]
            return
        state = samples[0].state or self._begin()
        begun = samples[0].odometry
        for place in range(1, keep + 1):
            sample = samples[place]
            ahead_m, left_m, turn_rad = between(begun, samples[min(place + 1, keep)].odometry)
            if place == keep or abs(ahead_m) + abs(left_m) > _STEP_M or abs(turn_rad) > _STEP_RAD:
                state = predict(state, between(begun, sample.odometry), self.noise)
                begun = sample.odometry
        samples[keep].state = state
        del samples[:keep]
