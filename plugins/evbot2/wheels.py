"""Motion control of the wheels in the firmware: moves by encoder, timed speeds, and stall detection."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from typing_extensions import override

from .messages import Code, State, Verb, WheelStatus
from .vehicle import Vehicle

MAX_TRAVEL_UM: Final = 100_000_000
"""Of a wheel in one move: 100 m."""

MIN_SPEED_UM_S: Final = 1000
HOLD_MS: Final = (20, 60_000)
"""The allowed hold times of speeds."""

STALL_S: Final = 1.5
"""Driven wheels without an encoder count for this time are stopped."""

_REST_S: Final = 0.06  # wheels without an encoder count for this time are at rest
_RAMP_SHARE: Final = 0.8  # of the acceleration, so that both wheels can ramp in proportion
_BRAKE_SHARE: Final = 0.45  # of the acceleration: less than half, so that the wheels can follow until the end
_CATCH_UP_HZ: Final = 4.0  # rate at which a wheel that lags behind its share catches up
_CATCH_UP_SHARE: Final = 0.2  # of the speed, at most
_OFF_STEPS: Final = 1.5  # in encoder steps: a move that ends with a greater error, because of a late tick, is continued
_LATEST_S: Final = 0.5  # upper limit of the tick interval in the speed calculation
_TRIES: Final = 3  # to end a move
_TICKS_TO_GO: Final = 2  # the rest of a move takes at least this many ticks
_ROUNDING: Final = 1e-6
_UM: Final = 1e6


class Actuator(ABC):
    """The controller of a channel of the firmware."""

    def __init__(self) -> None:
        self._order = 0
        self._state = State.IDLE

    @property
    def is_busy(self) -> bool:
        """Whether it moves and needs ticks."""
        return self._state is State.MOVING

    @abstractmethod
    def accept(self, verb: Verb, numbers: Sequence[int], tag: int, now_s: float) -> Code:
        """Begin an order; return the reply code."""

    @abstractmethod
    def tick(self, now_s: float) -> None:
        """Advance the motion."""

    @abstractmethod
    def stop(self, state: State) -> None:
        """Stop the motion, if any, and record its end state."""

    @abstractmethod
    def status(self) -> tuple[int, ...]:
        """Return its numbers in the status."""


@dataclass(frozen=True, slots=True)
class WheelModel:
    """The wheel parameters of a make.

    Attributes:
        track_m: nominal distance of the wheels.
        step_m: travel of a wheel from one count of its encoder to the next.
        acceleration_m_s2: of each wheel.
    """

    track_m: float
    step_m: float
    max_speed_m_s: float
    acceleration_m_s2: float


@dataclass(slots=True)
class _Move:
    """A move of both wheels from rest to rest, which end at the same time."""

    left_m: float
    right_m: float
    speed_m_s: float
    start: tuple[int, int] = (0, 0)  # encoder counts at rest
    ramp_m_s: float = 0.0  # present speed limit of the faster wheel
    tries: int = 0
    is_begun: bool = False
    is_ending: bool = False

    @property
    def length_m(self) -> float:
        return max(abs(self.left_m), abs(self.right_m))

    def gone_m(self, counted: tuple[int, int], step_m: float) -> tuple[float, float]:
        """Return the travel of the wheels since rest."""
        return (counted[0] - self.start[0]) * step_m, (counted[1] - self.start[1]) * step_m

    def share(self, gone_m: tuple[float, float]) -> float:
        """Return the travelled share of both wheels, over 1 if they overshot."""
        signs = math.copysign(1.0, self.left_m), math.copysign(1.0, self.right_m)
        return (signs[0] * gone_m[0] + signs[1] * gone_m[1]) / (abs(self.left_m) + abs(self.right_m))

    def speeds_m_s(self, fastest_m_s: float, gone_m: tuple[float, float]) -> tuple[float, float]:
        """Return the wheels' speeds, in proportion to their lengths; a wheel that lags behind its share is faster."""
        share, most_m_s = self.share(gone_m), _CATCH_UP_SHARE * abs(fastest_m_s)
        left_m_s, right_m_s = (
            fastest_m_s * way_m / self.length_m + max(-most_m_s, min(most_m_s, _CATCH_UP_HZ * (share * way_m - gone)))
            for way_m, gone in zip((self.left_m, self.right_m), gone_m, strict=True)
        )
        return left_m_s, right_m_s


class WheelController(Actuator):
    """Controls both wheels.

    Args:
        tick_s: nominal tick interval while it is busy.
    """

    def __init__(self, vehicle: Vehicle, model: WheelModel, tick_s: float) -> None:
        super().__init__()
        self._vehicle = vehicle
        self._model = model
        self._least_tick_s = self._tick_s = tick_s
        self._ticked_s = -math.inf
        self._move: _Move | None = None
        self._hold_until_s = -math.inf
        self._driven = (0.0, 0.0)
        self._counted = self._count()
        self._counted_s = -math.inf  # time of the last encoder count

    @override
    def accept(self, verb: Verb, numbers: Sequence[int], tag: int, now_s: float) -> Code:
        if verb is Verb.STOP:
            self.stop(State.STOPPED)
            return Code.OK
        if not self._is_in_range(verb, numbers):
            return Code.RANGE
        self._order, self._state, self._counted_s, self._ticked_s = tag, State.MOVING, now_s, now_s
        if verb is Verb.MOVE:
            self._move = _Move(numbers[0] / _UM, numbers[1] / _UM, numbers[2] / _UM)
            self._drive(0.0, 0.0)
        else:
            self._move, self._hold_until_s = None, now_s + numbers[2] / 1000
            self._drive(numbers[0] / _UM, numbers[1] / _UM)
        self.tick(now_s)
        return Code.OK

    @override
    def tick(self, now_s: float) -> None:
        if not self.is_busy:
            return
        self._tick_s = min(max(now_s - self._ticked_s, self._least_tick_s), _LATEST_S)
        self._ticked_s = now_s
        if (counted := self._count()) != self._counted:
            self._counted, self._counted_s = counted, now_s
        if any(self._driven) and now_s - self._counted_s > STALL_S:
            self.stop(State.STALLED)
        elif self._move is not None:
            self._follow(self._move, now_s)
        elif now_s >= self._hold_until_s - _ROUNDING:
            self.stop(State.DONE)

    @override
    def stop(self, state: State) -> None:
        self._move = None
        self._drive(0.0, 0.0, always=True)
        if self._state is State.MOVING:
            self._state = state

    @override
    def status(self) -> WheelStatus:
        left, right = self._count()
        return WheelStatus(0, self._order, self._state, _signed(left), _signed(right), int(self._vehicle.strained()))

    def _follow(self, move: _Move, now_s: float) -> None:
        """Advance a move: come to rest, travel, come to rest."""
        stands = now_s - self._counted_s >= _REST_S - _ROUNDING
        if not move.is_begun:
            if not stands:
                return
            move.start, move.is_begun = self._counted, True
        gone_m = move.gone_m(self._counted, self._model.step_m)
        missing_m = move.length_m * (1 - move.share(gone_m)) if move.length_m else 0.0
        if move.is_ending:
            if not stands:
                return
            if abs(missing_m) < _OFF_STEPS * self._model.step_m or move.tries >= _TRIES:
                self.stop(State.DONE)
                return
            move.is_ending, move.ramp_m_s = False, 0.0
        if -_OFF_STEPS * self._model.step_m < missing_m < self._model.step_m / 4:  # two encoders resolve half a step
            move.is_ending, move.tries, self._counted_s = True, move.tries + 1, now_s
            self._drive(0.0, 0.0)
            return
        if not any(self._driven):
            self._counted_s = now_s  # stall detection begins
        self._drive(*move.speeds_m_s(math.copysign(self._speed_m_s(move, abs(missing_m)), missing_m), gone_m))

    def _speed_m_s(self, move: _Move, missing_m: float) -> float:
        """Return the speed of the wheel with the longer travel for a remaining travel."""
        acceleration_m_s2 = self._model.acceleration_m_s2
        move.ramp_m_s += _RAMP_SHARE * acceleration_m_s2 * self._tick_s
        slowing_m_s = math.sqrt(2 * _BRAKE_SHARE * acceleration_m_s2 * missing_m)
        return min(move.speed_m_s, move.ramp_m_s, slowing_m_s, missing_m / (_TICKS_TO_GO * self._tick_s))

    def _drive(self, left_m_s: float, right_m_s: float, *, always: bool = False) -> None:
        if always or (left_m_s, right_m_s) != self._driven:
            self._driven = left_m_s, right_m_s
            self._vehicle.drive(left_m_s, right_m_s)

    def _count(self) -> tuple[int, int]:
        left_m, right_m = self._vehicle.travel_m()
        step_m = self._model.step_m
        return math.floor(left_m / step_m + _ROUNDING), math.floor(right_m / step_m + _ROUNDING)

    def _is_in_range(self, verb: Verb, numbers: Sequence[int]) -> bool:
        left, right, third = numbers
        most = round(self._model.max_speed_m_s * _UM)
        if verb is Verb.MOVE:
            return max(abs(left), abs(right)) <= MAX_TRAVEL_UM and MIN_SPEED_UM_S <= third <= most
        return verb is Verb.VEL and max(abs(left), abs(right)) <= most and HOLD_MS[0] <= third <= HOLD_MS[1]


def _signed(count: int) -> int:
    """Return a count modulo 2^32, from -2^31."""
    return (count + (1 << 31)) % (1 << 32) - (1 << 31)
