"""The recent odometry and fixes of a robot, in the order of their times, and the filter's state at each.

A fix is late: a picture takes time to be exposed, searched and sent, while the robot drives on. So a fix enters at its
own time, and the states after it are computed anew. States are computed when somebody asks: odometry arrives often and
is read seldom. Odometry that leaves the history is merged into a few steps of the filter.

Thread: one at a time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from eal_actors.device.localization.odometry_noise import OdometryNoise
from eal_actors.device.localization.pose_estimate import Pose, PoseEstimate
from eal_actors.device.localization.pose_filter import FilterState, between, beyond, predict, update

HISTORY_S: Final = 3.0
"""How long odometry is kept; a fix that is older cannot be applied."""
_SPACING_S: Final = 0.019
_MOST_ENTRIES: Final = 512
_STEP_S: Final = 0.25
_SAME_S: Final = 1e-9


@dataclass(slots=True)
class _Entry:
    """The odometry at a time, a fix of that time, and the filter's state after it, once it is computed."""

    stamp_s: float
    odometry: Pose
    state: FilterState | None = None
    fix: PoseEstimate | None = None


@dataclass(frozen=True, slots=True)
class Moment:
    """The filter just before a fix.

    Attributes:
        place: the index of the entry before it.
        odometry: the pose by odometry then.
        state: the state then, without the fix.
    """

    place: int
    odometry: Pose
    state: FilterState


class PoseHistory:
    """The history of one robot. `begin` returns the state at the first odometry of all."""

    def __init__(self, begin: Callable[[], FilterState]) -> None:
        self.noise = OdometryNoise()
        self._begin = begin
        self._entries: list[_Entry] = []

    def __bool__(self) -> bool:
        return bool(self._entries)

    @property
    def first_s(self) -> float:
        """The time of the oldest entry; infinite without one."""
        return self._entries[0].stamp_s if self._entries else math.inf

    @property
    def last_s(self) -> float:
        """The time of the newest entry; minus infinity without one."""
        return self._entries[-1].stamp_s if self._entries else -math.inf

    def add(self, pose: Pose, stamp_s: float) -> None:
        """Add the odometry at a time after the newest one.

        The newest entry moves on while it is close to the one before, or while the robot stands.
        """
        entries = self._entries
        if len(entries) > 1:
            last, before = entries[-1], entries[-2]
            is_close = last.stamp_s - before.stamp_s < _SPACING_S
            if last.fix is None and (is_close or last.odometry == pose == before.odometry):
                last.stamp_s, last.odometry, last.state = stamp_s, pose, None
                return
        entries.append(_Entry(stamp_s, pose))
        # The newest entry may move on, as after a reading.
        kept_s = entries[-2].stamp_s if len(entries) > 1 else stamp_s
        if len(entries) > _MOST_ENTRIES or kept_s - entries[0].stamp_s > 2 * HISTORY_S:
            self._forget(kept_s - HISTORY_S)

    def restart(self, pose: Pose, stamp_s: float) -> None:
        """Continue from another pose by odometry; the robot has not moved."""
        self._entries = [_Entry(max(stamp_s, self.last_s), pose, self.head() if self._entries else None)]

    def reset(self, state: FilterState) -> None:
        """Set the state at the newest entry, and forget what was before."""
        last = self._entries[-1]
        last.state, last.fix = state, None
        self._entries = [last]

    def moment(self, stamp_s: float) -> Moment:
        """Return the filter at a time within the history, for a fix."""
        self.head()
        place = self._place_before(stamp_s)
        before = self._entries[place]
        odometry = self._odometry_at(place, stamp_s)
        state = predict(before.state or self._begin(), between(before.odometry, odometry), self.noise)
        return Moment(place, odometry, state)

    def insert(self, moment: Moment, fix: PoseEstimate) -> None:
        """Apply a fix at its time; later fixes are applied again after it."""
        for later in self._entries[moment.place + 1 :]:
            later.state = None
        self._entries.insert(moment.place + 1, _Entry(fix.stamp_s, moment.odometry, update(moment.state, fix), fix))

    def begin_again(self, moment: Moment, stamp_s: float, state: FilterState) -> None:
        """Set the state at a time, and forget what was before and the fixes after it."""
        later = [_Entry(entry.stamp_s, entry.odometry) for entry in self._entries[moment.place + 1 :]]
        self._entries = [_Entry(stamp_s, moment.odometry, state), *later]

    def has(self, fix: PoseEstimate) -> bool:
        """Return whether the same fix was applied: one that came by two ways."""
        pose = fix.x_m, fix.y_m, fix.yaw_rad
        fixes = (entry.fix for entry in self._entries if entry.fix is not None)
        return any((known.x_m, known.y_m, known.yaw_rad) == pose for known in fixes)

    def head(self) -> FilterState:
        """Return the state at the newest entry; compute what is missing."""
        entries = self._entries
        place = len(entries) - 1
        while place > 0 and entries[place].state is None:
            place -= 1
        state = entries[place].state = entries[place].state or self._begin()
        for number in range(place + 1, len(entries)):
            before, entry = entries[number - 1], entries[number]
            state = predict(state, between(before.odometry, entry.odometry), self.noise)
            if entry.fix is not None:
                state = update(state, entry.fix)
            entry.state = state
        return state

    def estimate(self, stamp_s: float) -> PoseEstimate:
        """Return the estimate at a time: the newest for a later one, the oldest for an earlier one."""
        head = self.head()
        if stamp_s >= self.last_s:
            return head.estimate(self.last_s)
        if stamp_s <= self.first_s:
            return (self._entries[0].state or head).estimate(self.first_s)
        return self.moment(stamp_s).state.estimate(stamp_s)

    def _place_before(self, stamp_s: float) -> int:
        """Return the index of the last entry at or before a time, at least 0."""
        place = len(self._entries) - 1
        while place > 0 and self._entries[place].stamp_s > stamp_s + _SAME_S:
            place -= 1
        return place

    def _odometry_at(self, place: int, stamp_s: float) -> Pose:
        """Return the odometry at a time between the entry at an index and the next one."""
        before = self._entries[place]
        if place + 1 == len(self._entries):
            return before.odometry
        after = self._entries[place + 1]
        share = max(0.0, (stamp_s - before.stamp_s) / (after.stamp_s - before.stamp_s))
        ahead_m, left_m, turn_rad = between(before.odometry, after.odometry)
        return beyond(before.odometry, (ahead_m * share, left_m * share, turn_rad * share))

    def _forget(self, until_s: float) -> None:
        """Drop the entries before a time, but the last of them; without fixes among them, in a few steps."""
        entries = self._entries
        keep = max(self._place_before(until_s), len(entries) - _MOST_ENTRIES // 2)
        if any(entry.fix is not None for entry in entries[: keep + 1]):
            self.head()
        else:  # also where a reading has computed the states: readings must not change later estimates
            entries[keep].state = self._merged(keep)
            for entry in entries[keep + 1 :]:
                entry.state = None
        del entries[:keep]

    def _merged(self, keep: int) -> FilterState:
        """Return the state at an entry, by few steps from the first one."""
        begun, former = self._entries[0], self._entries[0]
        state = begun.state or self._begin()
        for entry in self._entries[1 : keep + 1]:
            if entry.stamp_s - begun.stamp_s > _STEP_S and former is not begun:
                state = predict(state, between(begun.odometry, former.odometry), self.noise)
                begun = former
            former = entry
        return predict(state, between(begun.odometry, former.odometry), self.noise)
