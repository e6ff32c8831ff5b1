"""Robots that drive freely, together: their state in one array with a column for each.

The path of a robot that touches nothing follows from its wheels alone. Here numpy computes the next ticks of many
robots at once. Operations and their order are those of `SimRobot.predict`, and sines are those of the math module:
where numpy's differ in the last bit, as on some processors, that module computes them one by one. So a path is the same
to the bit in the array and outside, and a robot may enter and leave at any tick.

The pose estimate hears of the odometry less often than that of a robot by itself: in steps as large as those in which
it merges old odometry anyway.

Thread: every member is for the holder of the world's lock.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final, Generic, NamedTuple, TypeAlias, TypeVar

import numpy as np

from .arena import Pose2D
from .motion import NORMALS_BLOCK, ODOMETER_ROUNDING, STRAIGHT_RAD, NormalNumbers

if TYPE_CHECKING:
    from numpy.typing import NDArray


_Array: TypeAlias = "NDArray[np.float64]"
_Number = TypeVar("_Number")
_R = TypeVar("_R", bound="FreeRobot")

MOST_TICKS: Final = NORMALS_BLOCK // 2
"""The most ticks at once: a robot needs two random numbers in each."""

LEAST_WORK: Final = 60
"""Robots times ticks from which the array is faster than the robots one by one."""

_REPORT_M: Final = 0.1
_REPORT_RAD: Final = 0.3
_REPORT_TICKS: Final = 25
"""The most that the odometry advances, and the ticks, until the pose estimate hears of it."""

_FEWEST: Final = 16  # columns of the array at first


class FreeState(NamedTuple, Generic[_Number]):
    """The state of a robot, one number each; or that of all robots, one row each.

    The last two poses and the travel of the last tick come after the pose; then the wheels, the odometer, the battery,
    the motion as `WheelMotion.regular` describes it, and the odometry that the pose estimate knows.
    """

    x_m: _Number
    y_m: _Number
    yaw_rad: _Number
    last_x_m: _Number
    last_y_m: _Number
    last_yaw_rad: _Number
    earlier_x_m: _Number
    earlier_y_m: _Number
    earlier_yaw_rad: _Number
    command_left_m: _Number
    command_right_m: _Number
    ahead_m: _Number
    turn_rad: _Number
    left_m: _Number
    right_m: _Number
    turned_m: _Number
    share_left: _Number
    share_right: _Number
    k_left: _Number
    k_right: _Number
    scatter_m: _Number
    effective_track_m: _Number
    step_m: _Number
    noise_rad_m: _Number
    odometer_x_m: _Number
    odometer_y_m: _Number
    odometer_yaw_rad: _Number
    counted_left_m: _Number
    counted_right_m: _Number
    factor_left: _Number
    factor_right: _Number
    track_factor: _Number
    half_track_m: _Number
    drawn_before_as: _Number
    idle_a: _Number
    drive_as_m: _Number
    capacity_as: _Number
    most_m: _Number
    regular_ticks: _Number
    is_move: _Number
    motion_left: _Number
    motion_right: _Number
    length_m: _Number
    acceleration_m_s2: _Number
    peak_m_s: _Number
    ramp_s: _Number
    duration_s: _Number
    motion_tick: _Number
    travelled_m: _Number
    reported_x_m: _Number
    reported_y_m: _Number
    reported_yaw_rad: _Number
    reported_tick: _Number


_ODOMETER: Final = slice(FreeState._fields.index("odometer_x_m"), FreeState._fields.index("counted_left_m"))
_REPORTED: Final = slice(FreeState._fields.index("reported_x_m"), len(FreeState._fields))


class FreeRobot(ABC):
    """A robot whose state an array may have.

    Attributes:
        free: the robots with which it drives freely, in one array that has its state; None if it has its own.
    """

    free: FreeRobots[Any] | None = None

    @property
    @abstractmethod
    def normals(self) -> NormalNumbers:
        """The random numbers of its wheels."""

    @abstractmethod
    def join(self, free: FreeRobots[Any], ticks: int) -> FreeState[float] | None:
        """Give its state to an array until `leave`, if its next ticks are regular; return the state, or None."""

    @abstractmethod
    def leave(self) -> None:
        """Take its state back from the array, if one has it."""

    @abstractmethod
    def adopt(self, state: FreeState[float], ticks: int) -> None:
        """Copy its state from an array, after some ticks since the last copy."""

    @abstractmethod
    def report(self, odometry: Pose2D, now_s: float) -> None:
        """Note a pose by odometry for the pose estimate."""


class FreeRobots(Generic[_R]):
    """The robots that drive freely at present.

    Attributes:
        robots: the robots, in the order of the columns.
    """

    def __init__(self, tick_s: float) -> None:
        self._tick_s = tick_s
        self._tick = 0
        self.robots: list[_R] = []
        self._columns: dict[_R, int] = {}
        self._updated_at: list[int] = []
        self._state: _Array = np.zeros((len(FreeState._fields), _FEWEST))
        self._normals: _Array = np.zeros((_FEWEST, 2 * NORMALS_BLOCK))
        self._next_normal = np.zeros(_FEWEST, dtype=np.intp)

    def drive(self, robots: Sequence[_R], tick: int, ticks: int) -> list[_R]:
        """Drive robots for MOST_TICKS at most, while their motions are regular; return those that drive by themselves.

        The robots are all that drive freely; every other one has left before.
        """
        self._tick = tick
        for robot in robots:
            if robot.free is None:
                self._add(robot, ticks)
        self._dismiss(ticks)
        others = [robot for robot in robots if robot.free is None]
        if self.robots:
            self._advance(FreeState._make(self._state[:, : len(self.robots)]), ticks)
            self._tick += ticks
            self._report()
        return others

    def places(self) -> _Array:
        """Return where the robots are, shape (n, 2)."""
        return self._state[:2, : len(self.robots)].T

    def column_of(self, robot: _R) -> int:
        """Return the row of a robot in `places`."""
        return self._columns[robot]

    def pose_of(self, robot: _R) -> Pose2D:
        """Return the pose of a robot."""
        x_m, y_m, yaw_rad = self._state[:3, self._columns[robot]].tolist()
        return x_m, y_m, yaw_rad

    def update(self, robot: _R) -> None:
        """Copy a robot's state from the array to the robot, unless it has it already."""
        column = self._columns[robot]
        ticks = self._tick - self._updated_at[column]
        if ticks:
            self._updated_at[column] = self._tick
            robot.adopt(FreeState._make(self._state[:, column].tolist()), ticks)

    def remove(self, robot: _R) -> None:
        """Give a robot its state back; the last column takes its place."""
        self.update(robot)
        column, last = self._columns.pop(robot), len(self.robots) - 1
        robot.normals.put_back(self._normals[column, self._next_normal[column] :].tolist())
        moved, updated_at = self.robots.pop(), self._updated_at.pop()
        if column != last:
            self.robots[column], self._updated_at[column], self._columns[moved] = moved, updated_at, column
            self._state[:, column] = self._state[:, last]
            self._normals[column] = self._normals[last]
            self._next_normal[column] = self._next_normal[last]

    def _add(self, robot: _R, ticks: int) -> None:
        """Take a robot's state, if its motion is regular for some ticks."""
        state = robot.join(self, ticks)
        if state is None:
            return
        column = len(self.robots)
        if column == self._state.shape[1]:
            self._state = np.concatenate([self._state, np.zeros_like(self._state)], axis=1)
            self._normals = np.concatenate([self._normals, np.zeros_like(self._normals)])
            self._next_normal = np.concatenate([self._next_normal, np.zeros_like(self._next_normal)])
        self._columns[robot] = column
        self.robots.append(robot)
        self._updated_at.append(self._tick)
        self._state[:, column] = state._replace(
            regular_ticks=state.regular_ticks + self._tick,
            motion_tick=state.motion_tick - self._tick,
            reported_tick=self._tick,
        )
        numbers = robot.normals.take_all(more_than=NORMALS_BLOCK)
        self._next_normal[column] = first = 2 * NORMALS_BLOCK - len(numbers)
        self._normals[column, first:] = numbers

    def _dismiss(self, ticks: int) -> None:
        """Remove the robots whose motions end within some ticks, or whose batteries may."""
        state: FreeState[_Array] = FreeState._make(self._state[:, : len(self.robots)])
        end = self._tick + ticks
        drawn_as = state.drawn_before_as + state.idle_a * (end * self._tick_s)
        drawn_as += state.drive_as_m * (state.turned_m + (ticks + 1) * state.most_m)
        ends = (state.regular_ticks < end) | (drawn_as >= state.capacity_as)
        for robot in [self.robots[column] for column in np.flatnonzero(ends).tolist()]:
            robot.leave()

    def _advance(self, state: FreeState[_Array], ticks: int) -> None:
        """Advance all columns. The arrays of what happens have a row for each tick."""
        command = self._commands(state, ticks)
        state.command_left_m[:], state.command_right_m[:] = command[0][-1], command[1][-1]
        turned_m = _sums(state.turned_m, (np.abs(command[0]) + np.abs(command[1])) / 2)
        left_m, right_m = command[0] * state.share_left, command[1] * state.share_right
        totals = _sums(state.left_m, left_m), _sums(state.right_m, right_m)
        left, right = left_m * state.k_left, right_m * state.k_right
        scatters = state.scatter_m != 0.0
        if scatters.any():
            normals = self._draw(scatters, ticks)
            for wheel, wheel_m, numbers in ((left, left_m, normals[0::2]), (right, right_m, normals[1::2])):
                np.add(wheel, state.scatter_m * np.sqrt(np.abs(wheel_m)) * numbers, out=wheel, where=scatters)
        ahead_m = (left + right) / 2
        turn_rad = (right - left) / state.effective_track_m + left_m * state.noise_rad_m
        x_m, y_m, yaw_rad = _moved(state.x_m, state.y_m, state.yaw_rad, ahead_m, turn_rad)
        earlier = (x_m[-3], y_m[-3], yaw_rad[-3]) if ticks > 1 else (state.last_x_m, state.last_y_m, state.last_yaw_rad)
        self._count(state, totals)
        poses = (x_m[-1], y_m[-1], yaw_rad[-1], x_m[-2], y_m[-2], yaw_rad[-2])
        self._state[6:9, : len(self.robots)] = earlier
        self._state[0:6, : len(self.robots)] = poses
        state.ahead_m[:], state.turn_rad[:] = ahead_m[-1], turn_rad[-1]
        state.left_m[:], state.right_m[:], state.turned_m[:] = totals[0][-1], totals[1][-1], turned_m[-1]

    def _report(self) -> None:
        """Tell pose estimates the odometry that has advanced."""
        now = self._state[_ODOMETER, : len(self.robots)]
        reported = self._state[_REPORTED, : len(self.robots)]
        change = np.abs(now - reported[:3])
        far = (change[0] + change[1] > _REPORT_M) | (change[2] > _REPORT_RAD)
        columns = np.flatnonzero(far | (self._tick - reported[3] >= _REPORT_TICKS))
        if columns.size:
            reported[:3, columns], reported[3, columns] = now[:, columns], self._tick
            for column, pose in zip(columns.tolist(), zip(*now[:, columns].tolist(), strict=True), strict=True):
                self.robots[column].report(pose, self._tick * self._tick_s)

    def _commands(self, state: FreeState[_Array], ticks: int) -> tuple[_Array, _Array]:
        """Return the commanded travel of the left and the right wheels."""
        shape = ticks, len(self.robots)
        left, right = np.broadcast_to(state.motion_left, shape), np.broadcast_to(state.motion_right, shape)
        moves = state.is_move != 0.0
        if not moves.any():
            return left, right
        time_s = (state.motion_tick + np.arange(self._tick + 1, self._tick + ticks + 1)[:, np.newaxis]) * self._tick_s
        left_s = state.duration_s - time_s
        travelled_m = np.where(
            time_s < state.ramp_s,
            state.acceleration_m_s2 * time_s * time_s / 2,
            np.where(
                left_s < state.ramp_s,
                state.length_m - state.acceleration_m_s2 * left_s * left_s / 2,
                state.peak_m_s * (time_s - state.ramp_s / 2),
            ),
        )
        travelled_m = np.where(left_s <= 0, state.length_m, travelled_m)
        steps_m = np.diff(travelled_m, axis=0, prepend=state.travelled_m[np.newaxis])
        state.travelled_m[:] = travelled_m[-1]
        return np.where(moves, left * steps_m, left), np.where(moves, right * steps_m, right)

    def _draw(self, scatters: NDArray[np.bool_], ticks: int) -> _Array:
        """Return the next random numbers of each robot, two rows for each tick."""
        count = len(self.robots)
        first = self._next_normal[:count]
        columns = first[:, np.newaxis] + np.arange(2 * ticks)
        numbers: _Array = self._normals[np.arange(count)[:, np.newaxis], columns].T
        first += 2 * ticks * scatters
        for column in np.flatnonzero(first >= NORMALS_BLOCK).tolist():
            first[column] -= NORMALS_BLOCK
            self._normals[column, :NORMALS_BLOCK] = self._normals[column, NORMALS_BLOCK:]
            self._normals[column, NORMALS_BLOCK:] = self.robots[column].normals.block()
        return numbers

    def _count(self, state: FreeState[_Array], totals: tuple[_Array, _Array]) -> None:
        """Advance the odometers by the counts of the encoders."""
        counts = []
        for total_m, before_m in zip(totals, (state.counted_left_m, state.counted_right_m), strict=True):
            counted_m = np.floor(total_m / state.step_m + ODOMETER_ROUNDING) * state.step_m
            counted_m[0] = before_m
            counts.append(np.diff(counted_m, axis=0))
            before_m[:] = counted_m[-1]
        left_m, right_m = counts[0] * state.factor_left, counts[1] * state.factor_right
        arc_m = (right_m - left_m) / 2 / state.track_factor
        odometer = self._state[_ODOMETER, : len(self.robots)]
        odometer[:] = [
            path[-1]
            for path in _moved(
                odometer[0], odometer[1], odometer[2], (left_m + right_m) / 2, arc_m / state.half_track_m
            )
        ]


def _sums(first: _Array, parts: _Array) -> _Array:
    """Return the running sums from `first` on; the first row is `first` itself."""
    sums: _Array = np.add.accumulate(np.concatenate([first[np.newaxis], parts]), axis=0)
    return sums


def _moved(
    x_m: _Array, y_m: _Array, yaw_rad: _Array, ahead_m: _Array, turn_rad: _Array
) -> tuple[_Array, _Array, _Array]:
    """Return the poses along arcs, the first row before the first arc; compare `motion.moved`."""
    half_rad = turn_rad / 2
    yaws_rad = _sums(yaw_rad, turn_rad)
    heading_rad = yaws_rad[:-1] + half_rad
    bends = np.abs(half_rad) > STRAIGHT_RAD
    chord_m = ahead_m
    if bends.any():  # often not so for encoders, which count whole steps
        chord_m = np.divide(ahead_m * _sin(half_rad), half_rad, out=ahead_m.copy(), where=bends)
    return (
        _sums(x_m, chord_m * _cos(heading_rad)),
        _sums(y_m, chord_m * _sin(heading_rad)),
        yaws_rad,
    )


def _each(function: Callable[[float], float]) -> Callable[[_Array], _Array]:
    """Return a function of the math module for arrays."""

    def values_of(arguments: _Array) -> _Array:
        values = np.fromiter(map(function, arguments.ravel().tolist()), np.float64, arguments.size)
        return values.reshape(arguments.shape)

    return values_of


def _same(numpys: Callable[[_Array], _Array], exact: Callable[[_Array], _Array]) -> Callable[[_Array], _Array]:
    """Return numpy's function if it is the math module's to the bit, else that one.

    An implementation of its own differs in some of a thousand values. Short arrays and the ends of long ones may have
    yet another one.
    """
    angles = np.random.default_rng(1).standard_normal(4099) * 10.0
    parts = [angles, angles * 1e-6, *(angles[size : 2 * size] for size in range(1, 18))]
    return numpys if all(np.array_equal(numpys(part), exact(part)) for part in parts) else exact


_sin, _cos = _same(np.sin, _each(math.sin)), _same(np.cos, _each(math.cos))
